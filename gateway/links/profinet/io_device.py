"""The PROFINET link of the gateway: an IO device on an Ethernet interface.

New output data of the controller steps the drive objects; input data is sent with the timing of the device. Name and address from
DCP are in the store. The axes do not wait for the data hold time of the relationship (up to 1.92 s): ``watchdog_factor`` cycles
without data are a loss of the PLC.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final, Protocol
from uuid import UUID

from pdgw.base.durations import MS
from pdgw.ds301.counters import Counters
from pdgw.ds301.loop.loop import Loop, Task, Timer
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.finding_text import finding_line
from pdgw.gateway.base.reasons import Finding
from pdgw.gateway.base.store import ParameterStore
from pdgw.gateway.base.udp import Address
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.links.frame_places import FramePlaces
from pdgw.gateway.links.link import AT_ONCE, FrameRecorder, Link, discard_waiting, is_punctual, silence, watch_calls
from pdgw.gateway.links.losses import RepeatedLosses
from pdgw.gateway.links.profinet import findings
from pdgw.gateway.links.profinet.diagnosis import Diagnosed, DiagnosisReport
from pdgw.gateway.links.profinet.ethernet import EthernetPort
from pdgw.gateway.links.profinet.pairing import Pairing
from pdgw.gateway.links.profinet.relationship import Places, Relationship
from pdgw.gateway.links.profinet.station import StationKeeper, profinet_model
from pdgw.gateway.links.profinet.traffic import Traffic
from pdgw.profidrive.frame import IOPS_GOOD
from pdgw.profidrive.telegrams import Telegram
from pdgw.profinet.connection.cmdev import Event
from pdgw.profinet.connection.cpm import Verdict
from pdgw.profinet.device import Connected, DeviceEvent, Disconnected, ProfinetDevice
from pdgw.profinet.rpc.server import NoRecords, RecordHandler
from pdgw.profinet.station import Station

log = logging.getLogger("gateway")

_DIAGNOSIS_NS: Final = 50 * MS
_EARLY_NS: Final = 5 * MS
"""The diagnosis is reported with the cycle if it is due so soon: another wake costs more."""
_NOT_IN_FORCE: Final = -1
"""Instead of the orders of a frame that did not count: the next frame is a step of the axes."""
_HELD_UP: Final = "the gateway was held up for longer than the watchdog time, and frames waited meanwhile"


class Served(Diagnosed, Protocol):
    """Data of a drive object for the link."""

    telegram: Telegram


class ProfinetLink(Link):
    """``Link`` over PROFINET. Records are served once ``serve_records`` has named who does it."""

    def __init__(
        self,
        port: EthernetPort,
        config: GatewayConfig,
        store: ParameterStore,
        loop: Loop,
        objects: Sequence[Served],
        seed: UUID | None = None,
    ) -> None:
        transport = config.transport
        self.port = port
        self._config = config
        self._store = store
        self._loop = loop
        self._objects = objects
        self._telegrams = [item.telegram for item in objects]
        self._records_of: Callable[[str], RecordHandler] = lambda host: NoRecords()
        self._tasks: list[Task] = []
        self._timer: Timer | None = None
        self._relationship: Relationship | None = None
        """With the connected controller."""
        self._exchange: Callable[[], None] = lambda: None
        self._closed = False
        self._answering = False
        """The input frame is due, and is sent as soon as it contains the answer to the frame that was read for it."""
        self._watch: Timer | None = None
        self._receivable = False
        self._losses = RepeatedLosses(0)
        """Of the newest relationship."""
        self._read_at = 0
        self._received_at = 0
        self.more = True
        """Data after a punctual frame is processed in the next turn, which saves one system call in each cycle."""
        self._newest: tuple[Sequence[Sequence[int]], Sequence[bool]] | None = None
        """Actual values of the last step and whether they are valid: what a new relationship begins with."""
        self._places: Places | None = None
        self.setpoints: list[Sequence[int] | None] = [None] * len(objects)
        self.layout_token = object()
        self.recorder: FrameRecorder | None = None
        self.log_event: Callable[[str], object] = lambda _: None
        self.watchdog_expiries = 0
        self._ended: findings.EndedRelationship | None = None
        """The newest one, until the next one begins."""
        self._unreported = ""
        """Reason of a loss that the axes have not seen yet: until then no setpoints count."""
        self._keeper = StationKeeper(port, transport, store, loop)
        model = profinet_model(transport, port.mac, config.objects, self._telegrams)
        name, ip = self._keeper.first_name(), self._keeper.first_ip()
        self.station = Station(model.identity, name, ip, link_up=port.link_up, medium=port.medium)
        self.device = ProfinetDevice(
            model,
            self.station,
            self._records_for,
            seed=UUID(bytes=os.urandom(16)) if seed is None else seed,
            now=loop.now(),
            boot_time=int(loop.wall()) & 0xFFFFFFFF,
            give_ip=self._keeper.give_ip,
        )
        self._traffic = Traffic(port, self.device, self.station, loop)
        self._diagnosis = DiagnosisReport(self.device, objects)
        self._failed = self.device.cm.server.on_error = partial(loop.unexpected, "a PROFINET call was aborted")
        watch_calls(self.device.cm.server, loop.counters, "calls")
        self._register_counters(loop.counters)

    def _register_counters(self, counters: Counters) -> None:
        add, device = partial(counters.add, "link"), self.device
        for verdict in Verdict:
            add(verdict.name.lower(), "frames", verdict.value, partial(self._count_of, verdict))
        add("foreign", "frames", "unknown relationship", lambda: device.foreign)
        add("watchdog_expiries", "times", "no frame in time while connected", lambda: self.watchdog_expiries)
        add("connects_refused", "times", "Connect refused", lambda: device.cm.refusals)
        add("dcp_refused", "blocks", "DCP Set rejected", lambda: device.dcp.refused)
        add("errors", "frames", "send or receive failed", lambda: self.port.errors)
        add("sent", "frames", "cyclic frames to the controller", lambda: device.cm.cyclic.sent)
        add("missed", "frames", "cyclic frames not sent in their cycle", lambda: device.cm.cyclic.missed)

    def _count_of(self, verdict: Verdict) -> int:
        return self.device.cm.cyclic.received[verdict]

    def serve_records(self, records_of: Callable[[str], RecordHandler]) -> None:
        """Set the handler of parameter access and I&M for each requesting host."""
        self._records_of = records_of

    def _records_for(self, host: str) -> RecordHandler:
        return self._records_of(host)

    # -- Link ---------------------------------------------------------------------------------------------------------

    @property
    def connected(self) -> bool:
        return self.device.connected

    @property
    def peer_host(self) -> str | None:
        relation = self.device.relation
        return str(relation.source[0]) if relation and relation.connected else None

    @property
    def takes_together(self) -> bool:
        pairing = self._pairing
        return pairing is not None and pairing.is_short

    @property
    def _pairing(self) -> Pairing | None:
        relationship = self._relationship
        return None if relationship is None else relationship.pairing

    def start(self, action: Callable[[], None]) -> None:
        station = self.station
        log.info("PROFINET device %s on %s", station.name or "without a name", self._config.transport.interface)
        self._exchange = action
        self.port.start(action, self._on_other, self._on_carrier)
        self._tasks.append(self._loop.spawn(self._serve, "PROFINET calls"))
        self._on_watch()
        self._pump()

    def receive(self, now: int, at_most: int = AT_ONCE) -> bool:
        device, relationship = self.device, self._relationship
        since, self._read_at = now - self._read_at, now
        if relationship is not None and since > relationship.held_up_ns and discard_waiting(self.port.receive):
            # Frames that waited for an unknown time are not a sign of life, and their orders may be old.
            self._report_loss(_HELD_UP)
        fresh = False
        for _ in range(at_most):
            frame = self.port.receive()
            if frame is None:
                break
            if device.on_frame(frame, now):
                fresh = True
                if relationship is None or relationship.is_changed(device.relation):
                    # The axes process a changed order or a STOP before the frames after it, which wake the loop.
                    if relationship is not None and relationship.pairing is not None:
                        relationship.pairing.end()
                    break
        if not device.quiet:
            self._pump()
        self.more = True
        if fresh:
            self._read_setpoints(now)
        return fresh

    def _read_setpoints(self, now: int) -> None:
        relationship, setpoints = self._relationship, self.setpoints
        if relationship is None:
            return
        consumer, pairing = relationship.consumer, relationship.pairing
        since, self._received_at = now - self._received_at, now
        self.more = not is_punctual(since, consumer.cycle_ns)
        if pairing is not None and not pairing.together:
            pairing.came(now)
        if self._unreported:
            relationship.ordered = _NOT_IN_FORCE
            return
        if since > relationship.limit_ns:
            self._losses.returned(now, since)
        payload = consumer.payload
        for index, unpack_from, offset, iops in relationship.outputs:
            good = consumer.running and payload[iops] & IOPS_GOOD
            setpoints[index] = unpack_from(payload, offset) if good else None
        self._receivable = True

    def poll(self, now: int) -> str:
        if not self._receivable:
            return ""
        relationship = self._relationship
        if self._unreported:
            loss, self._unreported = self._unreported, ""
        elif relationship is None or relationship.consumer.data_ns is None:
            loss = "" if self._ended is None else self._ended.finding.evidence
        else:
            limit_ns = relationship.limit_ns
            if now - relationship.consumer.data_ns <= limit_ns:
                return ""
            loss = silence(self._config.transport.watchdog_factor)
            self.watchdog_expiries += 1
            relation = self.device.relation
            if relation is not None and (found := findings.of_frames(relation, now, limit_ns >> 1)) is not None:
                loss = f"{loss}: {finding_line(found)}"
                self._losses.add(now, 0, found)
        self._receivable = False
        self.lose_setpoints()
        return self._losses.report(loss, now)

    def _report_loss(self, loss: str) -> None:
        """The next step of the axes sees this loss, also if the controller is there again by then."""
        if self._receivable:
            self._unreported = loss

    def finding(self, index: int | None = None) -> Finding | None:
        now, relation, relationship = self._loop.now(), self.device.relation, self._relationship
        if relation is not None and relation.state in findings.START_UP:
            return findings.of_start_up(relation, now)
        if relation is None or relationship is None:
            transport, refused = self._config.transport, self._keeper.refused(now)
            return findings.without_relationship(self.station, transport.interface, refused, self._ended)
        if (repeated := self._losses.finding(now)) is not None:
            return repeated
        missing = None if index is None or self.setpoints[index] is not None else index
        return relationship.finding(relation, now, missing, receivable=self._receivable)

    @property
    def age_ns(self) -> int | None:
        return None

    def lose_setpoints(self) -> None:
        for index in range(len(self.setpoints)):
            self.setpoints[index] = None

    def send(self, actuals: Sequence[Sequence[int]], good: Sequence[bool], now: int) -> None:
        self._newest = (actuals, good)
        relation = self.device.relation
        if relation is not None and relation.provider is not None:
            # Filled from the Connect on: the data must be valid at ApplicationReady.
            places = self._places
            if places is None or relation is not places.relation:
                places = self._places = Places(relation, relation.provider, self._telegrams)
            places.fill(actuals, good)
        if self._answering:
            pairing = self._pairing
            lead = 0 if pairing is None else pairing.lead
            self._answering = not self._provide(self._loop.now() + lead)
        watch = self._watch
        if watch is not None and now + _EARLY_NS >= watch.when:
            watch.cancel()
            self._on_watch()

    def set_layout(self, telegrams: Sequence[Telegram]) -> None:
        if self.device.relation is not None:
            raise GatewayError(
                "telegram: cannot be changed while a controller is connected, because its project defines it"
            )
        self._telegrams = list(telegrams)
        self._newest = None
        transport = self._config.transport
        self.device.replug(profinet_model(transport, self.port.mac, self._config.objects, self._telegrams))

    def places(self) -> FramePlaces:
        relationship = self._relationship
        offsets = {} if relationship is None else {index: offset for index, _, offset, _ in relationship.outputs}
        setpoints = tuple(offsets.get(index) for index in range(len(self._telegrams)))
        data = [None] * len(self._telegrams) if self._places is None else self._places.data
        return FramePlaces("profinet", setpoints, tuple(None if place is None else place[0] for place in data))

    def newest(self) -> tuple[bool, Address | None, bytes, bytes | bytearray]:
        relation = self.device.relation
        if relation is None or relation.consumer is None or relation.provider is None:
            return False, None, b"", b""
        return relation.connected, None, relation.consumer.payload, relation.provider.frame

    @property
    def received_ns(self) -> int | None:
        relation = self.device.relation
        return relation.consumer.data_ns if relation is not None and relation.consumer is not None else None

    def keep(self, field: str, text: str) -> None:
        """Store a text of the station."""
        self._keeper.keep(field, text)

    def status(self) -> dict[str, object]:
        relation = self.device.relation
        return {
            "connected": self.connected,
            "peer": list(relation.source) if relation else None,
            "frames": {verdict.value: self._count_of(verdict) for verdict in Verdict},
            "station": self._keeper.status(self.station, relation),
        }

    def close(self) -> None:
        self._closed = True
        self.device.end(Event.STOPPED, self._loop.now())
        self._traffic.send(self.recorder)
        self._release()
        for task in self._tasks:
            task.kill()
        for timer in (self._timer, self._watch):
            if timer is not None:
                timer.cancel()
        self.port.close()

    # -- the device on the loop ---------------------------------------------------------------------------------------

    def _on_other(self) -> None:
        self._traffic.receive(self.recorder, self._loop.now())
        self._pump()

    def _on_carrier(self) -> None:
        up, self.station.medium = self.port.link_up, self.port.medium
        if up != self.station.link_up:
            log.log(logging.INFO if up else logging.ERROR, "cable %s", "plugged" if up else "pulled")
            self.device.on_link(up, self._loop.now())
            self._pump()
        if self._keeper.address_changed():
            # The port no longer receives calls of the controller, and its relationship has ended.
            self.station.ip = self._keeper.address
            self.device.end(Event.NAME_CHANGED, self._loop.now())
            self._pump()

    def _serve(self) -> None:
        """Calls run in a task: one that writes to the disk waits there, and the exchange continues."""
        while True:
            data, source = self._traffic.calls.get()
            try:
                pairing = self._pairing
                if pairing is not None and pairing.together:
                    self._exchange()  # the waiting frame arrived before this call
                self.device.on_datagram(data, source, self._loop.now())
                relation = self.device.relation
                connected = relation is not None and relation.connected
                if not connected:
                    self.lose_setpoints()
                relationship = self._relationship
                ours = relationship is not None and relation is not None and relation.consumer is relationship.consumer
                if ours and not connected:
                    # Setpoints of the controller do not count until the parameters are complete.
                    self._report_loss("the controller sends its parameters again (PrmBegin)")
                placed = None if self._places is None else self._places.relation
                if self._newest is not None and relation is not None and relation is not placed:
                    self.send(*self._newest, self._loop.now())
                self._pump()
            except Exception as error:  # an error of one call: serve the next one
                self._failed(error)

    def _on_due(self) -> None:
        pairing, now = self._pairing, self._loop.now()
        sent = False
        if pairing is not None and pairing.due(now):
            before, self._answering = self._received_at, True
            self._exchange()
            sent, self._answering = not self._answering, False
            if self._closed:
                return
            found = self._received_at != before
            if not found and pairing.again(self._loop.now()):
                self._call_at(self.device.cyclic_deadline, exactly=True)
                return
            pairing.taken(self._received_at, found=found)
        if sent or self._provide(now):
            self._call_at(self.device.cyclic_deadline)  # the exchange may have set another deadline
        else:
            if self._timer is not None:
                self._timer.cancel()
                self._timer = None
            self.device.poll(now)
            self._pump()

    def _provide(self, now: int) -> bool:
        """Send the input frame, where that is all there is to do."""
        frame = self.device.provide(now)
        if frame is None:
            return False
        self.port.send(frame)
        return True

    def _pump(self) -> None:
        """Send waiting frames, report events, and set the timer for the next call."""
        self._traffic.send(self.recorder)
        for event in self.device.events():
            self._on_event(event)
        due = self.device.next_deadline()
        if self._timer is None or due < self._timer.when:
            self._call_at(due)

    def _call_at(self, due: int, *, exactly: bool = False) -> None:
        if self._timer is not None:
            self._timer.cancel()
        pairing = self._pairing
        if pairing is not None and not exactly:
            due = pairing.wake(due)
        self._timer = self._loop.call_at(due, self._on_due)

    def _on_event(self, event: DeviceEvent) -> None:
        match event:
            case Connected(relation):
                provider, consumer = relation.provider, relation.consumer
                if provider is None or consumer is None:
                    return
                self._release()
                transport, modules = self._config.transport, self.device.model.modules
                self._relationship = relationship = Relationship(
                    relation, consumer, provider, self.port, transport, self._telegrams, modules
                )
                self._losses = RepeatedLosses(relationship.limit_ns)
                self._ended = None
                self._keeper.forget_refused()
                self.layout_token = object()
                log.info("%s", relationship.text)
                self.log_event(f"PLC connected: {relationship.text}")
                relationship.warn(transport.cycle_time_ms)
            case Disconnected(relation, ended):
                if self._places is not None and relation is self._places.relation:
                    self._places = None
                text = f"controller {relation.plan.ar.station_name} disconnected: {ended.text}"
                log.error("%s", text)
                self.log_event(f"PLC not connected: {text}")
                end = findings.of_end(relation, ended, self._loop.now())
                self._ended = findings.EndedRelationship(end, relation.source[0])
                self._keeper.forget_refused()
                self._release()
                self.lose_setpoints()
                self._report_loss(end.evidence)
            case _:
                self._keeper.on_event(event, self.station.name)

    def _release(self) -> None:
        """Nothing is taken of the relationship any more."""
        pairing, self._relationship = self._pairing, None
        if pairing is not None:
            pairing.end()

    def _on_watch(self) -> None:
        self._watch = self._loop.call_later(_DIAGNOSIS_NS, self._on_watch)
        if self._diagnosis.report():
            self._pump()
