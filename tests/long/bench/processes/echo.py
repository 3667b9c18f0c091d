"""The floor of every latency: a plain UDP echo in a separate process.

The same as ``echo.c``, for a machine without a C compiler. Prints its port and answers until its standard input closes.
"""

from __future__ import annotations

import select
import socket
import sys


def main() -> None:
    """Echo datagrams on a free loopback port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        print(sock.getsockname()[1], flush=True)
        poll = select.poll()
        poll.register(sock, select.POLLIN)
        poll.register(sys.stdin, select.POLLIN | select.POLLHUP)
        stdin = sys.stdin.fileno()
        while True:
            for descriptor, _ in poll.poll():
                if descriptor == stdin:
                    return
                data, source = sock.recvfrom(2048)
                sock.sendto(data, source)


if __name__ == "__main__":
    main()
