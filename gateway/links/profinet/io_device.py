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
from pdgw.ds301.loop.loop import Loop
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
from pdgw.gateway.links.profinet.relationship import InputLayout, Places, Reception, Relationship
from pdgw.gateway.links.profinet.station import StationKeeper, profinet_model
from pdgw.gateway.links.profinet.traffic import Running, Traffic
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
        self._layout = InputLayout([item.telegram for item in objects])
        self._records_of: Callable[[str], RecordHandler] = lambda host: NoRecords()
        self._running: Running | None = None
        self._relationship: Relationship | None = None
        """With the connected controller."""
        self._reception: Reception | None = None
        self._losses = RepeatedLosses(0)
        """Of the newest relationship."""
        self._read_at = 0
        self._received_at = 0
        self.more = True
        """Data after a punctual frame is processed in the next turn, which saves one system call in each cycle."""
        self.setpoints: list[Sequence[int] | None] = [None] * len(objects)
        self.layout_token = object()
        self.recorder: FrameRecorder | None = None
        self.log_event: Callable[[str], object] = lambda _: None
        self.watchdog_expiries = 0
        self._ended: findings.EndedRelationship | None = None
        """The newest one, until the next one begins."""
        self._keeper = StationKeeper(port, transport, store, loop)
        model = profinet_model(transport, port.mac, config.objects, self._layout.telegrams)
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
        self._traffic.count(loop.counters, lambda: self.watchdog_expiries)

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
        self.port.start(action, self._on_other, self._on_carrier)
        calls = self._loop.spawn(partial(self._serve, action), "PROFINET calls")
        self._running = Running(action, calls, self._loop.call_later(_DIAGNOSIS_NS, self._on_watch))
        self._diagnosis.report()
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
        reception = self._reception
        if reception is None:
            self._reception = Reception()
        elif reception.loss:
            relationship.ordered = _NOT_IN_FORCE
            return
        if since > relationship.limit_ns:
            self._losses.returned(now, since)
        payload = consumer.payload
        for index, unpack_from, offset, iops in relationship.outputs:
            good = consumer.running and payload[iops] & IOPS_GOOD
            setpoints[index] = unpack_from(payload, offset) if good else None

    def poll(self, now: int) -> str:
        reception, relationship = self._reception, self._relationship
        if reception is None:
            return ""
        if reception.loss:
            loss = reception.loss
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
        self._reception = None
        self.lose_setpoints()
        return self._losses.report(loss, now)

    def _report_loss(self, loss: str) -> None:
        """The next step of the axes sees this loss, also if the controller is there again by then."""
        if self._reception is not None:
            self._reception.loss = loss

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
        return relationship.finding(relation, now, missing, receivable=self._reception is not None)

    @property
    def age_ns(self) -> int | None:
        return None

    def lose_setpoints(self) -> None:
        for index in range(len(self.setpoints)):
            self.setpoints[index] = None

    def send(self, actuals: Sequence[Sequence[int]], good: Sequence[bool], now: int) -> None:
        layout, relation, relationship = self._layout, self.device.relation, self._relationship
        layout.newest = (actuals, good)
        if relation is not None and relation.provider is not None:
            # Filled from the Connect on: the data must be valid at ApplicationReady.
            places = layout.places
            if places is None or relation is not places.relation:
                places = layout.places = Places(relation, relation.provider, layout.telegrams)
            places.fill(actuals, good)
        if relationship is not None and (pairing := relationship.pairing) is not None and pairing.answering:
            pairing.answering = not self._provide(self._loop.now() + pairing.lead)
        running = self._running
        if running is not None and now + _EARLY_NS >= running.watch.when:
            running.watch.cancel()
            self._on_watch()

    def set_layout(self, telegrams: Sequence[Telegram]) -> None:
        if self.device.relation is not None:
            raise GatewayError(
                "telegram: cannot be changed while a controller is connected, because its project defines it"
            )
        self._layout = layout = InputLayout(telegrams)
        transport = self._config.transport
        self.device.replug(profinet_model(transport, self.port.mac, self._config.objects, layout.telegrams))

    def places(self) -> FramePlaces:
        relationship, places = self._relationship, self._layout.places
        offsets = {} if relationship is None else {index: offset for index, _, offset, _ in relationship.outputs}
        setpoints = tuple(offsets.get(index) for index in range(len(self._objects)))
        data = [None] * len(self._objects) if places is None else places.data
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
            "frames": {verdict.value: self.device.cm.cyclic.received[verdict] for verdict in Verdict},
            "station": self._keeper.status(self.station, relation),
        }

    def close(self) -> None:
        running, self._running = self._running, None
        self.device.end(Event.STOPPED, self._loop.now())
        self._traffic.send(self.recorder)
        self._release()
        if running is not None:
            running.end()
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

    def _serve(self, exchange: Callable[[], None]) -> None:
        """Calls run in a task: one that writes to the disk waits there, and the exchange continues."""
        while True:
            data, source = self._traffic.calls.get()
            try:
                pairing = self._pairing
                if pairing is not None and pairing.together:
                    exchange()  # the waiting frame arrived before this call
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
                newest, places = self._layout.newest, self._layout.places
                if newest is not None and relation is not None and (places is None or relation is not places.relation):
                    self.send(*newest, self._loop.now())
                self._pump()
            except Exception as error:  # an error of one call: serve the next one
                self._failed(error)

    def _on_due(self) -> None:
        running, relationship, now = self._running, self._relationship, self._loop.now()
        if running is None:
            return
        pairing = None if relationship is None else relationship.pairing
        sent = False
        if pairing is not None and pairing.due(now):
            before, pairing.answering = self._received_at, True
            running.exchange()
            sent, pairing.answering = not pairing.answering, False
            if self._running is None:
                return
            found = self._received_at != before
            if not found and pairing.again(self._loop.now()):
                self._call_at(self.device.cyclic_deadline, None)
                return
            pairing.taken(self._received_at, found=found)
        if sent or self._provide(now):
            self._call_at(self.device.cyclic_deadline, pairing)  # the exchange may have set another deadline
        else:
            if running.timer is not None:
                running.timer.cancel()
                running.timer = None
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
        due, running = self.device.next_deadline(), self._running
        if running is not None and (running.timer is None or due < running.timer.when):
            self._call_at(due, self._pairing)

    def _call_at(self, due: int, pairing: Pairing | None) -> None:
        """Do what is due then, and wake before that as the pairing needs it."""
        running = self._running
        if running is not None:
            if running.timer is not None:
                running.timer.cancel()
            running.timer = self._loop.call_at(due if pairing is None else pairing.wake(due), self._on_due)

    def _on_event(self, event: DeviceEvent) -> None:
        match event:
            case Connected(relation):
                provider, consumer = relation.provider, relation.consumer
                if provider is None or consumer is None:
                    return
                self._release()
                transport, modules = self._config.transport, self.device.model.modules
                self._relationship = relationship = Relationship(
                    relation, consumer, provider, self.port, transport, self._layout.telegrams, modules
                )
                self._losses = RepeatedLosses(relationship.limit_ns)
                self._ended = None
                self._keeper.forget_refused()
                self.layout_token = object()
                log.info("%s", relationship.text)
                self.log_event(f"PLC connected: {relationship.text}")
                relationship.warn(transport.cycle_time_ms)
            case Disconnected(relation, ended):
                places = self._layout.places
                if places is not None and relation is places.relation:
                    self._layout.places = None
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
        if self._running is not None:
            self._running.watch = self._loop.call_later(_DIAGNOSIS_NS, self._on_watch)
        if self._diagnosis.report():
            self._pump()
