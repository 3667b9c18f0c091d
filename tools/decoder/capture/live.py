"""Live sources, a network interface (raw socket, Linux) or a python-can bus, and times as the user gives them.

A live source ends when it is interrupted."""

from __future__ import annotations

import datetime
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack

from pdgw.base.durations import SECOND
from pdgw.gateway.base.errors import GatewayError
from pdgw.tools.decoder.capture.source import Source
from pdgw.tools.decoder.frames.engine import CanPacket, Packet
from pdgw.tools.decoder.frames.records import LinkType


def moment(text: str, option: str, zero_ns: int) -> int:
    """Nanoseconds of a time: seconds since ``zero_ns``, or an ISO time; GatewayError names the option."""
    try:
        return zero_ns + round(float(text) * SECOND)
    except (ValueError, OverflowError):
        pass
    try:
        return round(datetime.datetime.fromisoformat(text).timestamp() * SECOND)
    except (ValueError, OverflowError, OSError):
        raise GatewayError(f"{option} {text}: expected seconds or an ISO time like 2026-03-01T12:00:00") from None


EVERY_PROTOCOL = 3
"""ETH_P_ALL of linux/if_ether.h."""
_LOOPBACK = 772
"""ARPHRD_LOOPBACK of linux/if_arp.h."""
_OUTGOING = 4
"""PACKET_OUTGOING of linux/if_packet.h."""
_MAX_FRAME = 1 << 16
_WAIT = 0.2


def open_interface(name: str) -> Source:
    """Everything a network interface sends and receives; GatewayError where the system does not allow it."""
    closing = ExitStack()
    family = getattr(socket, "AF_PACKET", None)
    if family is None:
        raise GatewayError(f"--live {name}: live captures need Linux; record with dumpcap and decode the file")
    try:
        raw = closing.enter_context(socket.socket(family, socket.SOCK_RAW, socket.htons(EVERY_PROTOCOL)))
        raw.bind((name, 0))
    except OSError as error:
        closing.close()
        hint = "; it needs root or CAP_NET_RAW" if isinstance(error, PermissionError) else ""
        raise GatewayError(f"--live {name}: cannot be opened ({error.strerror or error}){hint}") from error
    return Source(name, _frames(raw, name), closing=closing)


def _frames(raw: socket.socket, name: str) -> Iterator[Packet]:
    number = 0
    while True:
        try:
            data, (_, _, kind, hardware, _) = raw.recvfrom(_MAX_FRAME)
        except OSError as error:
            raise GatewayError(f"--live {name}: {error.strerror or error}") from error
        if hardware == _LOOPBACK and kind == _OUTGOING:
            continue  # the interface delivers it as a received frame, too
        number += 1
        yield Packet(number, time.time_ns(), LinkType.ETHERNET, name, data)


def open_can(text: str) -> Source:
    """A python-can bus given as ``interface:channel`` or ``interface:channel@bitrate``; CanopenError when out of reach."""
    from pdgw.ds301.bus.interfaces import open_bus  # noqa: PLC0415 (python-can is slow to load, and captures do without)

    interface, _, rest = text.partition(":")
    channel, _, rate = rest.rpartition("@") if "@" in rest else (rest, "", "")
    if not interface or not channel or (rate and not rate.isdigit()):
        raise GatewayError(
            f"--live {text}: expected interface:channel or interface:channel@bitrate, like socketcan:can0"
        )
    bus = open_bus(interface, channel, int(rate) if rate else None)
    closing = ExitStack()
    closing.callback(bus.shutdown)
    return Source(text, _messages(bus, text), closing=closing)


def _messages(bus: object, name: str) -> Iterator[CanPacket]:
    import can  # noqa: PLC0415

    from pdgw.tools.decoder.capture.canlog import message_packet  # noqa: PLC0415

    assert isinstance(bus, can.BusABC)
    number = 0
    while True:
        try:
            message = bus.recv(_WAIT)
        except (can.CanError, OSError) as error:
            raise GatewayError(f"--live {name}: {error}") from error
        if message is not None:
            number += 1
            yield message_packet(number, message)
