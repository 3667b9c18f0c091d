"""Detect another master on a bus: before the start the gateway refuses, later it stops. Detect what other tools write by SDO.

Another gateway is visible by the heartbeat of our own node-ID or by RPDOs to our drives. The CAN port drops our own frames; only
SocketCAN with ``receive_own_messages`` delivers them. Two masters would overwrite each other's commands, and the heartbeat of
one would prevent the stop by the other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.communication import ERROR_CONTROL, HEARTBEAT_STATE, SDO_REQUEST, SDO_RESPONSE, SYNC, NmtState
from pdgw.ds301.emcy import HEARTBEAT_ERROR
from pdgw.ds301.node.client import NodeClient
from pdgw.ds301.node.node import Cause
from pdgw.ds301.pdo import PdoDirection
from pdgw.gateway.axis.values import FaultRecord
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.base.finding_text import clock
from pdgw.gateway.objects.drive_object import DriveObject

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
_BOOT_UP = bytes((NmtState.BOOT_UP,))
_BOOTED, _ANSWERED = "booted", "answered an SDO request"
_OTHER_ID = "give the device another node-ID, or set another [can] node_id"
_PAUSE_NS = 10 * SECOND
"""A device that repeats the same is reported again after this time."""
_SYNC_AFTER_BOOT_NS = 2 * SECOND
"""So soon after its boot-up a node is configured that sends SYNC by itself."""
_EFFECT_NS = 500 * MS
"""Within this time of the boot-up a drive shows that its heartbeat consumer reacts to it, with the time to read its fault."""


class SameNodeId:
    """A device with the node-ID of the gateway that has booted or answered an SDO request, and sends no heartbeat.

    Some makers deliver devices with node-ID 127. Without a heartbeat, such a device does not hide the loss of the gateway.
    """

    def __init__(self, network: CanNetwork, report: Callable[[str], None]) -> None:
        """``report``: called with one line when the device is heard after a pause."""
        self._network = network
        self._report = report
        self._seen: dict[str, int] = {}
        """What the device did, and when it did so last."""
        network.subscribe(SDO_RESPONSE + network.node_id, lambda _, now: self._note(_ANSWERED, now))

    def booted(self, now: int) -> None:
        """Its boot-up message arrived."""
        self._note(_BOOTED, now)

    def _note(self, what: str, now: int) -> None:
        before = self._seen.get(what)
        self._seen[what] = now
        if before is None or now - before > _PAUSE_NS:
            self._report(self.note)

    @property
    def who(self) -> str:
        """The device, for a heartbeat with its node-ID."""
        booted = self._seen.get(_BOOTED)
        return "a device with the same node-ID" if not booted else f"the device that booted at {self._clock(booted)}"

    @property
    def note(self) -> str:
        """What the device did last, and the remedy; empty if there is none."""
        bus, did = self._network, " and ".join(f"{what} at {self._clock(time)}" for what, time in self._seen.items())
        device = f"CAN bus {bus.name}: a device with node-ID {bus.node_id}, which is that of the gateway"
        return f"{device}, {did}; {_OTHER_ID}" if did else ""

    def explains(self, item: DriveObject, record: FaultRecord) -> Cause | None:
        """That a fault may follow from the boot-up, to which a heartbeat consumer reacts; None if it does not."""
        booted, client = self._seen.get(_BOOTED), item.client
        if booted is None or record.time_ns - booted > _EFFECT_NS:
            return None
        if record.number == FaultNumber.NODE_LOST:
            beats = client.heartbeat
            follows = client.loss is None and beats.time > booted and beats.state != NmtState.OPERATIONAL
        else:
            follows = record.code == HEARTBEAT_ERROR or record.number == FaultNumber.LEFT_OPERATION
        device = f"a device with the node-ID of the gateway, {self._network.node_id}"
        evidence = f"follows the boot-up at {self._clock(booted)} of {device}"
        return Cause(evidence, f"its heartbeat consumer (1016h) may react to it: {_OTHER_ID}") if follows else None

    def _clock(self, time_ns: int) -> str:
        return clock(time_ns, self._network.loop)


class SyncOfNodes:
    """SYNC of other senders on a bus: of a node that has booted and whose 1005h has bit 30, until its bring-up clears that."""

    def __init__(self, network: CanNetwork, clients: Sequence[NodeClient[Any]]) -> None:
        self._network = network
        self._booted: dict[NodeClient[Any], int] = {}
        """When, by node."""
        self._pending = False
        for client in clients:
            network.subscribe(ERROR_CONTROL + client.settings.node_id, partial(self._beat, client))

    def _beat(self, client: NodeClient[Any], data: bytes, now: int) -> None:
        if data[:1] == _BOOT_UP:
            self._booted[client] = now

    def explains(self, else_: Callable[[], None]) -> bool:
        """A node may send it that has just booted. ``else_`` is called if its 1005h turns out to have no bit 30."""
        now = self._network.loop.now()
        suspects = {client: time for client, time in self._booted.items() if now - time <= _SYNC_AFTER_BOOT_NS}
        if suspects and not self._pending:
            self._pending = True

            def decide() -> None:
                self._pending = False
                if not any(client.sdo.had_sync for client in suspects):
                    else_()

            self._network.loop.call_at(max(suspects.values()) + _SYNC_AFTER_BOOT_NS, decide)
        return bool(suspects)


def watch_for_masters(
    network: CanNetwork,
    drives: Iterable[int],
    same: SameNodeId,
    sync_of_nodes: SyncOfNodes,
    on_found: Callable[[Cause], None],
) -> None:
    """Call ``on_found`` for every frame on ``network`` that only a master sends.

    ``drives``: the node-IDs of our drives. A drive that is online adds the RPDOs that it has in use. ``same`` takes the boot-up
    messages with the node-ID of the gateway, which has none.
    """

    def found(cob_id: int, what: str, who: str = "another master", remedy: str = "") -> None:
        evidence = f"CAN bus {network.name}: {who} sends {what} (COB-ID {cob_id:03X}h)"
        todo = f"allowed is one gateway per bus: end the other one, {remedy}or disable receive_own_messages of the interface"
        on_found(Cause(evidence, todo))

    def beats(data: bytes, now: int) -> None:
        if data[:1] == _BOOT_UP:
            same.booted(now)
            return
        state = NmtState.text(data[0] & HEARTBEAT_STATE) if data else "empty"
        what = f"the heartbeat of node {network.node_id} ({state}), which is the node-ID of this gateway"
        found(own, what, f"another gateway, or {same.who},", f"{_OTHER_ID}, ")

    def other(cob_id: int, what: str) -> None:
        if cob_id != SYNC or not sync_of_nodes.explains(lambda: found(cob_id, what)):
            found(cob_id, what)

    network.on_other_sender = other
    own = ERROR_CONTROL + network.node_id
    network.subscribe_pdo(own, beats)
    for node_id in drives:
        for number, cob_id in enumerate(PdoDirection.RPDO.predefined(node_id), 1):
            network.claim(cob_id, f"RPDO{number} of drive {node_id}")


def watch_for_writes(
    network: CanNetwork, node_id: int, relies_on: Callable[[int, int], bool], on_write: Callable[[int, int], None]
) -> None:
    """Call ``on_write`` with index and sub-index when another SDO client writes an object of a node that the gateway
    ``relies_on``."""

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
                on_write(index, subindex)

    network.subscribe(SDO_REQUEST + node_id, request)
