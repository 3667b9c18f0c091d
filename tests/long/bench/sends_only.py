"""A process that only sends an Ethernet frame each cycle: the part of the jitter that the machine causes.

It runs as a file, without imports of this package: ``INTERFACE CYCLE_NS FRAME_ID``.
"""

from __future__ import annotations

import socket
import sys
import time

RECEIVER = bytes.fromhex("02000000007f")
"""Address without a receiver."""
ETHERTYPE_RT = bytes.fromhex("8892")
DATA_SIZE = 44
NS_PER_S = 1e9


def main(interface: str, cycle_ns: int, frame_id: bytes) -> None:
    sock = socket.socket(socket.AF_PACKET, socket.SOCK_RAW)
    sock.bind((interface, 0))
    frame = RECEIVER + sock.getsockname()[4] + ETHERTYPE_RT + frame_id + bytes(DATA_SIZE)
    due = time.monotonic_ns()
    while True:
        due += cycle_ns
        left = due - time.monotonic_ns()
        if left > 0:
            time.sleep(left / NS_PER_S)
        sock.send(frame)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), bytes.fromhex(sys.argv[3]))
