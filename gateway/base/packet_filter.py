"""Filters in the kernel (classic BPF, Linux), so that frames for others cost the exchange nothing.

Source: linux/filter.h. A program is a sequence of instructions; a packet for which it returns 0 is dropped.
"""

from __future__ import annotations

import ctypes
import ipaddress
import socket
import struct
from collections.abc import Sequence

Instruction = tuple[int, int, int, int]
"""Code, jump if true, jump if false, operand."""
LOAD_HALF, LOAD_WORD, JUMP_EQUAL, JUMP_GREATER_EQUAL, JUMP_GREATER, RETURN = 0x28, 0x20, 0x15, 0x35, 0x25, 0x06
_JUMP_SET = 0x45
_SO_ATTACH_FILTER, _SO_DETACH_FILTER = 26, 27
_NETWORK_HEADER = 0xFFF0_0000
"""SKF_NET_OFF: offsets from here count from the IP header; other offsets on a UDP socket count from the UDP header."""
_SOURCE_ADDRESS = _NETWORK_HEADER + 12
_SOURCE_PORT = 0
_RANDOM = 0xFFFF_F000 + 56
"""SKF_AD_OFF + SKF_AD_RANDOM: a random number."""
_SAMPLE = 0xFF
"""Of 256 datagrams of other senders, one is received."""
_EVERYTHING = 0xFFFF


def attach(to: socket.socket, program: Sequence[Instruction]) -> None:
    """Have the kernel drop what the program returns 0 for; OSError where it cannot."""
    code = b"".join(struct.pack("HBBI", *instruction) for instruction in program)
    _attach(to, len(program), ctypes.create_string_buffer(code, len(code)))


def _attach(to: socket.socket, length: int, code: ctypes.Array[ctypes.c_char]) -> None:
    # The caller keeps the code until the kernel has it: a compiled function releases a variable after its last use.
    to.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, struct.pack("HL", length, ctypes.addressof(code)))


def detach(of: socket.socket) -> None:
    """Let everything through again; OSError where there was no filter."""
    of.setsockopt(socket.SOL_SOCKET, _SO_DETACH_FILTER, 0)


def from_sender(host: str, port: int) -> list[Instruction]:
    """UDP datagrams of this sender, and so few of others that they can be named."""
    return [
        (LOAD_WORD, 0, 0, _SOURCE_ADDRESS),
        (JUMP_EQUAL, 0, 3, int(ipaddress.IPv4Address(host))),
        (LOAD_HALF, 0, 0, _SOURCE_PORT),
        (JUMP_EQUAL, 0, 1, port),
        (RETURN, 0, 0, _EVERYTHING),
        (LOAD_WORD, 0, 0, _RANDOM),
        (_JUMP_SET, 1, 0, _SAMPLE),
        (RETURN, 0, 0, _EVERYTHING),
        (RETURN, 0, 0, 0),
    ]
