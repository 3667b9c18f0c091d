"""Detect another master on a bus: before the start the gateway refuses, later it stops. Detect what other tools write by SDO.

Another gateway is visible by the heartbeat of our own node-ID or by RPDOs to our drives. The CAN port drops our own frames; only
SocketCAN with ``receive_own_messages`` delivers them. Two masters would overwrite each other's commands, and the heartbeat of
one would prevent the stop by the other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from pdgw.base.durations import MS
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.communication import ERROR_CONTROL, SDO_REQUEST
from pdgw.ds301.pdo import PdoDirection

LISTEN_NS = 250 * MS
"""Listening time before the first frame is sent: longer than the usual heartbeat of 100 ms."""

_COMMAND = 0xE0
"""These bits of the first byte of an SDO request are its command (CiA 301)."""
_DOWNLOAD, _BLOCK_DOWNLOAD = 1 << 5, 6 << 5
_END = 1
"""Bit of a block download that ends it; without it, the request begins one."""
_NUMBER, _LAST = 0x7F, 0x80
"""The first byte of a segment of a block download: its number, and the bit of the last one."""
_SUBINDEX = 3
"""Place of the sub-index, after the index."""


def watch_for_masters(network: CanNetwork, drives: Iterable[int], on_found: Callable[[str], None]) -> None:
    """Call ``on_found`` with one line for every frame on ``network`` that only a master sends.

    ``drives``: the node-IDs of our drives. A drive that is online adds the RPDOs that it has in use.
    """

    def found(cob_id: int, what: str) -> None:
        on_found(
            f"CAN bus {network.name}: another master sends {what} (COB-ID {cob_id:03X}h); allowed: one "
            "gateway per bus. End the other one, or disable receive_own_messages of the interface"
        )

    network.on_other_sender = found
    network.claim(
        ERROR_CONTROL + network.node_id,
        f"the heartbeat of node {network.node_id}, which is the node-ID of this gateway",
    )
    for node_id in drives:
        for number, cob_id in enumerate(PdoDirection.RPDO.predefined(node_id), 1):
            network.claim(cob_id, f"RPDO{number} of drive {node_id}")


def watch_for_writes(
    network: CanNetwork, node_id: int, relies_on: Callable[[int, int], bool], on_write: Callable[[str], None]
) -> None:
    """Call ``on_write`` with one line when another SDO client writes an object of a node that the gateway ``relies_on``."""

    segment: int | None = None  # the newest one of a block download; None: the last request was another one

    def request(data: bytes, _now: int) -> None:
        nonlocal segment
        if len(data) <= _SUBINDEX:
            return
        number = data[0] & _NUMBER
        if segment is not None and number in (segment + 1, 1):
            segment = 0 if data[0] & _LAST else number  # after the last one: the end, or segments again from 1
            return
        command = data[0] & _COMMAND
        blocks = command == _BLOCK_DOWNLOAD and not data[0] & _END
        segment = 0 if blocks else None
        if blocks or command == _DOWNLOAD:
            index, subindex = int.from_bytes(data[1:_SUBINDEX], "little"), data[_SUBINDEX]
            if relies_on(index, subindex):
                on_write(f"another tool writes {index:04X}h/{subindex}")

    network.subscribe(SDO_REQUEST + node_id, request)
