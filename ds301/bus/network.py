"""One CAN bus: a port, and the receivers of its frames.

Every frame is taken once, in the loop: COB-IDs with a PDO subscription go straight to their owner, all others (SDO, EMCY,
heartbeat) to their subscribers. Sending never waits: a frame goes out at once while the interface has room; otherwise its
sender waits in the send queue. A port that is lost is opened again with a growing pause.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Final

from pdgw.base.durations import MS
from pdgw.ds301.bus.can_frame import ERROR, ERROR_BUS_OFF, ERROR_CONTROLLER, EXTENDED, REMOTE
from pdgw.ds301.bus.flood import Flood, FloodWatch
from pdgw.ds301.bus.health import BusHealth, Outage
from pdgw.ds301.bus.listeners import FrameListener, FrameTap, message_of
from pdgw.ds301.bus.load import DEFAULT_BITRATE
from pdgw.ds301.bus.node_checks import NodeChecks
from pdgw.ds301.bus.port import CanPort, Opener, PortBusyError, PortLostError, Receiver
from pdgw.ds301.bus.reopening import Reopening
from pdgw.ds301.bus.sdo_queue import SdoQueue
from pdgw.ds301.bus.send_queue import FrameQueue, Sender, SendQueue
from pdgw.ds301.bus.sync_demand import SyncDemand
from pdgw.ds301.communication import (
    DEFAULT_GATEWAY_NODE_ID,
    ERROR_CONTROL,
    NMT,
    SDO_REQUEST,
    SDO_RESPONSE,
    SYNC,
    NmtState,
)
from pdgw.ds301.loop.jobs import Turns
from pdgw.ds301.loop.loop import Loop
from pdgw.ds301.pdo import PdoCallback, PdoCalls, PdoReceiver

log = logging.getLogger("gateway")

_OPERATIONAL: Final = bytes((NmtState.OPERATIONAL,))
_ONE_BYTE: Final = bytes(1)
"""Data of a remote request: only its length is sent."""
_ASK_AGAIN_NS: Final = 5 * MS
"""An interface that has not reported room for this time is tried again."""
_BRING_UPS: Final = 16
"""Nodes configured at a time if the load of the bus is unknown."""
_QUARTER: Final = 4
"""Part of the time for an answer that a request may wait before it is sent."""
_FUNCTION: Final = 0x780
"""The part of a COB-ID that names the service."""
UNUSED: Final = 0
"""Instead of a node-ID."""
_TO_REQUEST: Final = SDO_REQUEST - SDO_RESPONSE


class _Interface:
    """The interface of a bus from its opening until it is lost or closed, and what waits for room in it."""

    def __init__(self, port: CanPort, put: Callable[[int, bytes], bool]) -> None:
        self.port = port
        self.listens = True
        """The port delivers frames when they arrive; False: they wait for ``take``."""
        self.send_queue = SendQueue()
        self.first_frames = FrameQueue(put)
        """NMT commands, heartbeat, node guarding."""
        self.frames = FrameQueue(put)
        """SDO requests and SYNC."""
        self.refused_at = 0
        """When it had no room last."""


class CanNetwork(Receiver):
    """A bus shared by the drives and encoders on it. CanopenError from the constructor when it cannot be opened."""

    def __init__(self, loop: Loop, opener: Opener, name: str = "can", node_id: int = DEFAULT_GATEWAY_NODE_ID) -> None:
        self.loop = loop
        self.name = name
        self.node_id = node_id
        """The gateway's own on this bus."""
        self.bring_ups = Turns(loop, _BRING_UPS)
        """Nodes that are configured at a time."""
        self._sdo = SdoQueue(loop, self.send)
        self.sent = 0
        self.received = 0
        self.send_errors = 0
        self.waits = 0
        self.lost = 0
        self.health = BusHealth()
        self.bitrate = DEFAULT_BITRATE
        self._reported: Outage | None = None
        """The outage that was reported last; None: the bus works."""
        self._floods = FloodWatch(loop, lambda: self.bitrate, self._note_evidence, self._report_flood)
        self._examines = False
        """A received frame counts for health or census."""
        self.listeners: list[FrameListener] = []
        self.on_drop: list[Callable[[], None]] = []
        """Called when frames of any sender were dropped."""
        self.tap: FrameTap | None = None
        """Called with every frame, at the lowest cost."""
        self.waiting = False
        """Senders wait for room: senders without a stop wait after them."""
        self._pdos: dict[int, PdoReceiver] = {}
        self._subscribers: dict[int, list[PdoCallback]] = {}
        self._nodes_seen: dict[int, int] = {}
        """Node-IDs that have sent a heartbeat or a boot-up message, and when the first one came."""
        self._nodes_of_pdos: dict[int, int] = {}
        """Node-ID by the COB-ID of a PDO."""
        self.checks = NodeChecks(loop, self.take)
        """Of the nodes that are online."""
        self.sync = SyncDemand()
        self.makes_sync = False
        """The gateway sends SYNC on this bus."""
        self.on_other_sender: Callable[[int, str], None] | None = None
        """Called with COB-ID and name when a frame arrives that only the gateway sends."""
        self.log_event: Callable[[str], object] = lambda _: None
        """Called with the text when the bus is lost, for another reason, or back."""
        self.syncs = 0
        """SYNC of the gateway, and of other senders that are claimed."""
        self._interface: _Interface | None = _Interface(opener(), self.put)
        """None while it is lost."""
        self._started = False
        self._reopening = Reopening(loop, name, opener, self._take_port)
        self._register_counters()

    def _register_counters(self) -> None:
        add, part, health = self.loop.counters.add, f"bus {self.name}", self.health
        add(part, "sent", "frames", "accepted by the interface", lambda: self.sent)
        add(part, "received", "frames", "received from other nodes", lambda: self.received)
        add(part, "syncs", "frames", "SYNC of the gateway and of other senders", lambda: self.syncs)
        add(
            part,
            "send_errors",
            "frames",
            "not sent: interface lost, queue full, or driver error",
            lambda: self.send_errors,
        )
        add(part, "waits", "times", "the interface was full; frames wait until it has room", lambda: self.waits)
        add(part, "error_frames", "messages", "error frames of the CAN controller", lambda: health.error_frames)
        add(part, "error_passive", "messages", "the CAN controller became error-passive", lambda: health.error_passive)
        add(part, "bus_off", "messages", "the CAN controller went bus-off", lambda: health.bus_off)
        add(part, "lost", "times", "interface lost; the gateway opens it again", lambda: self.lost)

    def start(self) -> None:
        """Take frames from now on."""
        self._started = True
        if self._interface is not None:
            self._interface.port.start(self)

    def close(self) -> None:
        """Release the interface for good."""
        self._started = False
        self.checks.cancel()
        self._reopening.cancel()
        self._floods.cancel()
        self._sdo.clear()
        if self._interface is not None:
            self._interface.port.close()
            self._interface = None

    def subscribe_pdo(self, cob_id: int, receiver: PdoReceiver | PdoCallback) -> None:
        """Route frames of this COB-ID to ``receiver`` only."""
        self._pdos[cob_id] = receiver if isinstance(receiver, PdoReceiver) else PdoCalls(receiver)

    def unsubscribe_pdo(self, cob_id: int) -> None:
        """End a subscription; a missing one is not an error."""
        self._pdos.pop(cob_id, None)

    def subscribe(self, cob_id: int, callback: PdoCallback) -> None:
        """Also call ``callback`` with the frames of this COB-ID, unless a PDO has it."""
        self._subscribers.setdefault(cob_id, []).append(callback)

    def unsubscribe(self, cob_id: int, callback: PdoCallback) -> None:
        """The end of ``subscribe``."""
        self._subscribers[cob_id].remove(callback)

    def unconfigured(self, since: int = 0) -> list[int]:
        """Nodes that were heard first after this time, and are none of those of the gateway."""
        seen = self._nodes_seen.items()
        return sorted(node for node, first in seen if first >= since and not self.is_subscribed(ERROR_CONTROL + node))

    @property
    def healthy(self) -> bool:
        """The bus works, as far as its interface shows."""
        return self.health.outage is None

    @property
    def disturbance(self) -> Outage | Flood | None:
        """Why the bus does not serve its nodes, or serves them late; None if it does."""
        return self.flood or self.health.shown(self.loop.now())

    @property
    def last_outage(self) -> Outage:
        """Why the bus is lost, or was lost last."""
        return self.health.shown(self.loop.now()) or self.health.last

    def is_subscribed(self, cob_id: int) -> bool:
        """Whether the frames of this COB-ID have a receiver, other than of a PDO."""
        return bool(self._subscribers.get(cob_id))

    def claim(self, cob_id: int, what: str) -> None:
        """Only the gateway sends this COB-ID: a frame with it is of another master. ``what``: its name for the message."""

        def received(_data: bytes, _now: int) -> None:
            self.syncs += cob_id == SYNC
            if self.on_other_sender is not None:
                self.on_other_sender(cob_id, what)

        self.subscribe_pdo(cob_id, received)

    def node_of_pdo(self, cob_id: int, node_id: int) -> int:
        """The node that has this COB-ID for a PDO: ``node_id`` from now on, unless another node already has it.

        ``UNUSED`` instead of a node-ID: PDOs of any node have it that cannot be disabled, and no node may send it.
        """
        return self._nodes_of_pdos.setdefault(cob_id, node_id)

    def listen(self, now: int, *, on: bool) -> None:
        """Whether frames are received when they arrive (the beginning), or may wait for ``take``: not while an SDO is open."""
        interface = self._interface
        if interface is not None and on is not interface.listens and (on or not self._sdo.awaits_answer(now)):
            interface.listens = on
            interface.port.listen(on=on)

    def take(self, now: int) -> None:
        """Receive the frames that have waited."""
        interface = self._interface
        if interface is not None and not interface.listens:
            interface.port.take(now)

    def send(self, cob_id: int, data: bytes) -> bool:
        """Send a frame, or queue it until the interface has room; True if the interface accepted it at once.

        NMT commands, heartbeat and node guarding do not wait for setpoints. False and counted when the interface is lost.
        """
        if cob_id == NMT or cob_id & _FUNCTION == ERROR_CONTROL:
            return self.send_first(cob_id, data)
        return not self.waiting and self.put(cob_id, data) or self._queue(cob_id, data, stop=False)

    def send_first(self, cob_id: int, data: bytes) -> bool:
        """As ``send``, before all that does not stop anything."""
        interface = self._interface
        is_next = interface is None or not interface.first_frames
        return is_next and self.put(cob_id, data) or self._queue(cob_id, data, stop=True)

    def _queue(self, cob_id: int, data: bytes, *, stop: bool) -> bool:
        interface = self._interface
        if interface is not None:
            frames = interface.first_frames if stop else interface.frames
            if frames.add(cob_id, data):
                self.wait(frames, stop=stop)
            else:
                self.send_errors += 1
        return False

    def leave_room(self, sdo_gap_ns: int, answer_ns: int) -> None:
        """Send one SDO request in ``sdo_gap_ns``, and limit the number of nodes that are configured at a time, so that none
        waits long for its turn.

        ``answer_ns``: the shortest time within which a node must answer a request, including the wait before it is sent.
        """
        self._sdo.gap_ns = sdo_gap_ns
        self.bring_ups.limit = max(1, answer_ns // _QUARTER // sdo_gap_ns)

    def request_sdo(self, node_id: int, data: bytes, *, first: bool) -> None:
        """Send a request, and receive its answer when it arrives. ``first``: as ``send_first``, else as ``send_acyclic``."""
        cob_id, now = SDO_REQUEST + node_id, self.loop.now()
        self._sdo.ask(cob_id, now)
        self.listen(now, on=True)
        (self.send_first if first else self.send_acyclic)(cob_id, data)

    def send_acyclic(self, cob_id: int, data: bytes) -> None:
        """As ``send``; SDO requests in their gap."""
        if not self._sdo.gap_ns or cob_id & _FUNCTION != SDO_REQUEST:
            self.send(cob_id, data)
        elif not self._sdo.add(cob_id, data):
            self.send_errors += 1

    def put(self, cob_id: int, data: bytes) -> bool:
        """Hand a frame to the interface now; False when it has no room or is lost. For senders whose turn it is."""
        interface = self._interface
        if interface is None:
            self.send_errors += 1
            return False
        try:
            interface.port.send(cob_id, data)
        except PortBusyError:
            self.waits += 1
            self._note_busy(interface)
            return False
        except PortLostError as error:
            self.send_errors += 1
            interface.port.close()
            self.on_lost(str(error))
            return False
        if self._examines:
            self.health.taken()
        self.sent += 1
        if self.tap is not None:
            self.tap.frame(cob_id, data, self.loop.now())
        if self.listeners:
            self._notify_listeners(cob_id, data, is_rx=False)
        return True

    def wait(self, sender: Sender, *, stop: bool) -> None:
        """``sender`` was refused, or must not overtake those who wait: it gets its turn when the interface has room.

        ``stop``: before all that does not stop anything.
        """
        interface = self._interface
        if interface is None:
            return
        interface.send_queue.add(sender, stop=stop)
        self.waiting = True
        if self.loop.now() - interface.refused_at >= _ASK_AGAIN_NS:
            self.on_room()

    def request(self, cob_id: int) -> bool:
        """A remote request of one byte, as ``send``."""
        return self.send(cob_id | REMOTE, _ONE_BYTE)

    def drop_waiting(self) -> None:
        """Drop unsent frames: earlier commands must not reach a lost node after its stop. Those to others are sent again."""
        if self._interface is not None:
            self._interface.port.drop()
        for send_again in self.on_drop:
            send_again()

    def send_heartbeat(self) -> None:
        """The gateway's own heartbeat. The cyclic exchange calls it, so that a hung loop stops the drives."""
        self.send(ERROR_CONTROL + self.node_id, _OPERATIONAL)

    def send_sync(self) -> None:
        """One SYNC, from the cyclic exchange."""
        if not self.sync.withheld_for:
            self.syncs += 1
            self.send(SYNC, b"")

    @property
    def flood(self) -> Flood | None:
        """What fills the bus; looked for only after a loss."""
        return self._floods.flood

    def examine(self) -> None:
        """A node is silent, or no frame goes out: does another sender fill the bus? Repeated while it does."""
        if self._interface is not None:
            self._floods.examine()

    def _report_flood(self, text: str, found: bool) -> None:
        text = f"bus {self.name}: {text}"
        if found:
            log.error("CAN %s", text, extra=self._reopening.log_fields)
        self.log_event(text)

    # -- events of the port ---------------------------------------------------------------------------------------------

    def on_frame(self, can_id: int, data: bytes, now: int) -> None:
        """A data frame with a standard identifier."""
        self.received += 1
        if self._examines:
            self.health.received(now)
            self._note_evidence()
            if (census := self._floods.census) is not None:
                census.count(can_id, len(data))
        if self.tap is not None:
            self.tap.frame(can_id, data, now)
        if self.listeners:
            self._notify_listeners(can_id, data, is_rx=True)
        receiver = self._pdos.get(can_id)
        if receiver is not None:
            receiver.receive(data, now)
            return
        if can_id > ERROR_CONTROL and can_id & _FUNCTION == ERROR_CONTROL:
            self._nodes_seen.setdefault(can_id - ERROR_CONTROL, now)
        else:
            self._sdo.asked.discard(can_id + _TO_REQUEST)
        for receive in self._subscribers.get(can_id, ()):
            receive(data, now)

    def on_other_frame(self, can_id: int, data: bytes, *, extended: bool, remote: bool) -> None:
        """A frame outside CANopen, or a request to another node."""
        self.received += 1
        if self._examines:
            self.health.received(self.loop.now())
            self._note_evidence()
        if self.tap is not None:
            flags = (EXTENDED if extended else 0) | (REMOTE if remote else 0)
            self.tap.frame(can_id | flags, data, self.loop.now())
        if self.listeners:
            self._notify_listeners(can_id, data, is_rx=True, extended=extended, remote=remote)

    def on_error_frame(self, *, bus_off: bool, passive: bool) -> None:
        """A single disturbed frame is repeated by the controller; only bus-off ends the traffic."""
        if self.tap is not None:
            kind = ERROR_BUS_OFF if bus_off else ERROR_CONTROLLER if passive else 0
            self.tap.frame(ERROR | kind, bytes(8), self.loop.now())
        self.health.error(self.loop.now(), bus_off=bus_off, passive=passive)
        self._note_evidence()

    def on_room(self) -> None:
        """The interface takes frames again."""
        self.waiting = self._interface is not None and not self._interface.send_queue.flush()

    def on_lost(self, text: str) -> None:
        """The interface is lost: report it, and open it again when it is back."""
        self._interface = None
        self._sdo.clear()
        self.waiting = False
        self.health.lost()
        self._note_evidence()
        self.lost += self._reopening.lost(text)
        if self._started:
            self._reopening.begin()

    def _take_port(self, port: CanPort) -> None:
        self._interface = _Interface(port, self.put)
        port.start(self)

    def on_refused(self) -> None:
        """A frame that the interface had taken did not go out."""
        self.send_errors += 1
        if self._interface is not None:
            self._note_busy(self._interface)

    def _note_busy(self, interface: _Interface) -> None:
        interface.refused_at = now = self.loop.now()
        self.health.busy(now)
        self._note_evidence()

    def _note_evidence(self) -> None:
        """There is evidence of the health of the bus, or a sample begins: report what has changed."""
        self._examines = self.health.doubted or self._floods.census is not None
        outage, before = self.health.outage, self._reported
        if outage is before:
            return
        self._reported = outage
        text = f"bus {self.name}: {'healthy' if outage is None else f'LOST: {outage.value}'}"
        self.log_event(text)
        if outage is not None:
            self.examine()
        if outage is not None and outage is not Outage.INTERFACE:  # whose line has the error of the system
            log.error("CAN %s", text, extra=self._reopening.log_fields)

    def _notify_listeners(
        self, can_id: int, data: bytes, *, is_rx: bool, extended: bool = False, remote: bool = False
    ) -> None:
        message = message_of(can_id, data, self.loop.wall(), is_rx=is_rx, extended=extended, remote=remote)
        for listener in self.listeners:
            listener(message)
