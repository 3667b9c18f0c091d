"""A process that only returns datagrams: the part of the response time that the machine needs.

It runs as a file, without imports of this package: ``PORT [PRIORITY]``.
"""

from __future__ import annotations

import os
import socket
import sys

DATAGRAM_MAX = 2048


def main(port: int, priority: str | None) -> None:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.bind(("0.0.0.0", port))
    if priority:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(int(priority)))
    while True:
        sock.sendto(*sock.recvfrom(DATAGRAM_MAX))


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2] if len(sys.argv) > 2 else None)
