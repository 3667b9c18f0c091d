"""The daemon: PLC, drive objects and buses of one configuration on one loop.

The gateway answers each valid PLC frame at once with the newest drive data. Without frames it steps the drive objects every cycle
and sends every second cycle. The gateway's heartbeat comes from the same loop, so a hung loop stops the drives. ``start`` and
``stop`` work on any loop; ``run`` runs the loop of the machine.
"""

from __future__ import annotations

import gc
import logging
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from typing import TYPE_CHECKING, Any

from pdgw.base.durations import MS
from pdgw.base.version import package_version
from pdgw.ds301.loop.loop import Event, Loop, Timer
from pdgw.ds301.node.client import NodeClient
from pdgw.ds301.node.node import Cause
from pdgw.gateway.axis.values import FaultRecord
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.base.platform import Platform, SystemPlatform
from pdgw.gateway.base.store import DeviceParameters, ParameterStore
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.daemon.buses import Buses
from pdgw.gateway.daemon.link_port import open_port
from pdgw.gateway.daemon.masters import LISTEN_NS
from pdgw.gateway.daemon.pause import Pause
from pdgw.gateway.daemon.shutdown import Shutdown
from pdgw.gateway.daemon.stored_objects import StoredObjects, connect, telegrams_named
from pdgw.gateway.daemon.sync import SyncProducer
from pdgw.gateway.links.cyclic import IDLE_NS
from pdgw.gateway.links.link import Link
from pdgw.gateway.objects.drive_object import DriveObject
from pdgw.gateway.service.cycle_times import CycleWatch
from pdgw.gateway.service.events import EventLog
from pdgw.gateway.service.running import Recording, Service

if TYPE_CHECKING:
    from pdgw.gateway.links.profinet.ethernet import EthernetPort

log = logging.getLogger("gateway")


class Daemon:
    """Owns link, buses, drive objects and services of one configuration.

    ``ethernet``: the interface of the PROFINET link; None opens the configured one.

    Raises GatewayError or CanopenError from the constructor if a port or a CAN interface cannot be opened.
    """

    def __init__(
        self, config: GatewayConfig, platform: Platform | None = None, ethernet: EthernetPort | None = None
    ) -> None:
        self.config = config
        self.platform: Platform = SystemPlatform() if platform is None else platform
        self.loop: Loop = self.platform.loop
        self.cycle_ns = int(config.transport.cycle_time_ms * MS)
        self.store = ParameterStore(config.store, log.warning, config.file)
        self.services: list[Service] = []
        self.watch = CycleWatch()
        """Called at the end of every cycle."""
        self.recorder: Recording | None = None
        self.file: tuple[str, float] | None = None
        """The file of the configuration, and its time of modification when it was read."""
        self.started_ns = self.loop.now()
        self.events = EventLog(self.loop.wall)
        self.events.add("gateway", None, f"gateway started, version {package_version()}")
        self.cycles = 0
        self.late = 0
        add = self.loop.counters.add
        add("loop", "cycles", "cycles", "for all drive objects", lambda: self.cycles)
        add("loop", "late", "cycles", "started more than half a cycle late", lambda: self.late)
        self.stopped = Event(self.loop)
        """Everything has come to rest and is released."""
        self.failure: GatewayError | None = None
        """Why it ended by itself."""
        self._begun = False
        self._stop_asked = False
        self._shutdown: Shutdown | None = None
        """The end, once it has begun."""
        self._together = False
        """Frames of the buses wait for the next cycle."""
        self._deadline = 0
        self._last_sent = 0
        self._due: Timer | None = None
        self._beat: Timer | None = None
        with ExitStack() as opened:
            if platform is None:
                opened.callback(self.loop.close)
            opened.enter_context(self.store.held())
            self.address, open_link = open_port(config, self.platform, self.store, ethernet, opened)
            """Where cyclic frames are received: address and port, or the Ethernet interface."""
            self.buses = Buses(config, self.platform, self.events, opened)
            self.networks = self.buses.networks
            self._networks = tuple(self.networks.values())
            with telegrams_named(self.replaced_telegrams):
                made = StoredObjects(config, self.networks, self.store, self.events, self.update_store)
                self.axes = [made.axis(item) for item in config.axis]
                self.encoder_nodes, self.encoders = made.encoders()
                self.objects: list[DriveObject] = [*self.axes, *self.encoders]
                """In the order of the frame."""
                count = len(self.objects)
                self._answer: tuple[list[Sequence[int]], list[bool]] = [()] * count, [False] * count
                """For each drive object after its last step: actual values, and whether they are good."""
                connect(self.axes, self.encoders)
                for bus in config.can:
                    self._selected().check_load(bus)
            self.link: Link = open_link(self.objects)
            self.link.log_event = partial(self.events.add, "plc", None)
            for index, item in enumerate(self.objects):
                item.log_event = self.events.add
                item.link_finding = partial(self.link.finding, index)
                item.explain = partial(self._explained, item)
            opened.callback(self.link.close)
            self._opened = opened.pop_all()
        self.buses.connect(self.objects, self.clients)
        shortest = min(self.cycle_ns * config.transport.watchdog_factor, self.buses.limit_ns)
        self._pause = Pause(shortest, partial(self.events.add, "gateway", None))
        for bus in config.can:
            self.buses.leave_room(bus, self._selected())

    @property
    def replaced_telegrams(self) -> list[str]:
        """One line for each stored telegram (P922) that differs from that of the configuration."""
        return self.config.replaced_telegrams(self.store.parameters.telegrams)

    @property
    def notes(self) -> list[str]:
        """One line for each thing to correct that does not stop a drive."""
        found = [*self.replaced_telegrams, *(item.note for item in self.buses.same_ids.values() if item.note)]
        clients = {item.client: item.label for item in reversed(self.objects)}
        return found + [f"{label}: {note}" for client, label in clients.items() for note in client.configuration.notes]

    def _explained(self, item: DriveObject, record: FaultRecord) -> FaultRecord:
        """A fault with what happened to the gateway, or on its bus, and led to it."""
        return self._pause.explain(record) or self.buses.explained(item, record)

    @property
    def sync_producers(self) -> Mapping[str, SyncProducer]:
        """The SYNC producers by the name of their bus."""
        return self.buses.sync_producers

    @property
    def name(self) -> str:
        """Name of the gateway."""
        if self.config.name is not None:
            return self.config.name
        if self.config.transport.type != "profinet":
            return "pdgw"
        stored = self.store.parameters.station_name
        return self.config.transport.station_name if stored is None else stored

    @property
    def clients(self) -> list[NodeClient[Any]]:
        """The client of every node."""
        return [*(axis.client for axis in self.axes), *(node.client for node in self.encoder_nodes)]

    def check_telegram_change(self, changed: DriveObject, number: int, asked_by: str | None) -> None:
        """Check that telegram ``number`` can be selected now. ``asked_by``: the address of the request, if any.

        GatewayError if not, CanopenError if the PDOs of the telegram do not fit on the bus.
        """
        if changed.may_have_power:
            raise GatewayError(
                f"{changed.label}: the telegram cannot be changed: the axis is in operation, or was when it was "
                "last online"
            )
        plc = self.link.peer_host
        if plc is not None and asked_by not in (None, plc):
            raise GatewayError(
                f"{changed.label}: {plc} is connected, and its frame would not fit any more; only the PLC may "
                f"change a telegram now, not {asked_by}"
            )
        self._selected(changed, number).check_load(self.config.bus_of(changed.config))

    def _selected(self, changed: DriveObject | None = None, number: int = 0) -> GatewayConfig:
        """The configuration with the telegrams in use (P922), and telegram ``number`` for ``changed``."""
        numbers = {item.do_id: item.telegram.number for item in (*self.axes, *self.encoders)}
        return self.config.with_telegrams(numbers if changed is None else numbers | {changed.do_id: number})

    def change_telegram(self, changed: DriveObject, number: int, asked_by: str | None = None) -> None:
        """Select a telegram (P922). The frame layout follows, and every drive object waits for frames that fit.

        GatewayError, ProfidriveError or CanopenError if this is not possible now.
        """
        if number == changed.telegram.number:
            return
        self.check_telegram_change(changed, number, asked_by)
        connected = self.link.connected
        before = [item.telegram for item in self.objects]
        chosen = changed.config.telegram_of(number)
        self.link.set_layout([chosen if item is changed else item.telegram for item in self.objects])
        try:
            changed.change_telegram(number)
        except BaseException:
            self.link.set_layout(before)
            raise
        self.buses.leave_room(self.config.bus_of(changed.config), self._selected())
        self.buses.find_sync()
        if connected:
            now = self.loop.now()
            for item in self.objects:
                text = f"telegram {number} of DO {changed.do_id}: the PLC has to send the new frame"
                item.raise_fault(FaultNumber.FRAME_CHANGED, text, now)

    def recall(self, ended: str, origins: Mapping[str, str]) -> None:
        """How the last gateway ended, empty if that is unknown; and its ``origins``. Before the start."""
        for item in self.objects:
            item.origins.recall(ended, origins.get(str(item.do_id), ""))

    def origins(self) -> dict[str, str]:
        """What has stopped the drive objects, by DO-ID: for the next gateway."""
        found = {str(item.do_id): item.origins.last(self.loop) for item in self.objects}
        return {do_id: text for do_id, text in found.items() if text}

    def last_event(self) -> str:
        """The newest event, with its drive object. Of a reason its evidence, as it is now, without the remedy."""
        event = self.events.last
        item = next((item for item in self.objects if item.do_id == event.do_id), None)
        if item is None:
            return event.text
        text = item.enable_status.text if event.kind == "reason" else event.text
        return f"{item.label}: {text}"

    def update_store(self, change: Callable[[DeviceParameters], None]) -> None:
        """Change stored parameters, in a task: saved first, then in force. GatewayError when the file cannot be written."""
        self.loop.result(self.loop.offload(lambda: self.store.update(change)))

    # -- life ---------------------------------------------------------------------------------------------------------

    def run(self) -> None:
        """Run until ``stop``; returns after the drives are stopped and everything is released.

        GatewayError when another master is on a bus. An unexpected error also ends it and is raised here after the drives were
        set to pre-operational.
        """
        try:
            self._listen()
            # All objects until now live until the end: keep the garbage collector from scanning them during a cycle.
            gc.collect()
            gc.freeze()
            self._exchange()
            self.loop.run()
        finally:
            gc.unfreeze()
            self._finish()
        if self.failure is not None:
            raise self.failure

    def start(self) -> None:
        """Begin everything on the loop; the buses are listened to for a moment before anything is sent on them."""
        self._listen()
        self._exchange()

    def _listen(self) -> None:
        log.info(
            "cyclic exchange on %s:%d, drive objects: %d, cycle %g ms, the PLC is lost after %d cycles without a frame",
            *self.address,
            len(self.objects),
            self.cycle_ns / MS,
            self.config.transport.watchdog_factor,
        )
        for text in self.replaced_telegrams:
            log.warning("%s", text)
        self.buses.listen(self._on_other_master)
        self._beat = self.loop.call_later(LISTEN_NS, self._begin)

    def _exchange(self) -> None:
        for service in self.services:
            service.start()
        self.link.start(self._on_link)
        self._deadline = self.loop.now()
        self._on_due()
        if self._stop_asked:
            self._begin_stop()

    def _begin(self) -> None:
        """No other master is on the buses."""
        if self._shutdown is not None:
            return  # one was found, or the gateway was stopped before it sent anything
        self._begun = True
        self._on_heartbeat()
        for client in self.clients:
            client.start()

    def _on_other_master(self, cause: Cause) -> None:
        if self.failure is None:
            self.failure = GatewayError(cause.text)
            log.error("%s", cause.text)
            for item in self.objects:
                item.raise_fault(FaultNumber.OTHER_MASTER, cause.evidence, self.loop.now(), cause.remedy)
            self._begin_stop()

    def stop(self) -> None:
        """Ask for the end: drives stopped, disabled, then pre-operational. From any thread, and from a signal handler."""
        self._stop_asked = True
        self.loop.call_threadsafe(self._begin_stop)

    def release(self) -> None:
        """Give ports and buses back; the end of a run does it. A second call does nothing."""
        self._opened.close()

    def _begin_stop(self) -> None:
        """As after a loss of the PLC: each axis stops its way, and only OFF2 and OFF3 count. The end waits until power is off
        everywhere, also in lost drives, or the time is over."""
        if self._shutdown is None and not self.stopped.is_set():
            self._shutdown = Shutdown(self.objects, self.loop.now())

    def _finish(self) -> None:
        if self.stopped.is_set():
            return
        for timer in (self._due, self._beat):
            if timer is not None:
                timer.cancel()
        self.loop.pace(0)
        # Stop the nodes first, each of them even if another one or a service fails.
        with ExitStack() as leaving:
            leaving.callback(log.info, "stopped")
            leaving.callback(self.loop.stop)
            leaving.callback(self.stopped.set)
            leaving.callback(self.release)
            for service in reversed(self.services):
                leaving.callback(service.stop)
            for client in reversed(self.clients if self._begun else ()):
                leaving.callback(client.stop)

    # -- the cyclic exchange ------------------------------------------------------------------------------------------

    def _on_link(self) -> None:
        """A frame of the PLC waits: answer the first one before anything else, then use the newest."""
        if self._together:
            self._take(together=True)
        self._on_received(self.link.receive(now := self.loop.now(), 1), now)
        if self.link.more:
            self._on_received(self.link.receive(now := self.loop.now()), now)

    def _take(self, *, together: bool) -> None:
        """Receive the frames of the buses that have waited: before the PLC's frame if it waits, too; else after it."""
        if self.link.takes_together is together:
            now = self.loop.now()
            for network in self._networks:
                network.take(now)

    def _on_received(self, accepted: bool, now: int) -> None:
        if accepted:
            self._cycle(now, accepted=self._shutdown is None)

    def _on_due(self) -> None:
        """A cycle without a frame, unless one waits: frames postpone it."""
        if self._together:
            self._take(together=True)
        now = self.loop.now()
        if now - self._deadline > self.cycle_ns // 2:
            self.late += 1
        # The queued frames arrived before this cycle: process them before the watchdog.
        accepted = self.link.receive(now) and self._shutdown is None
        self._cycle(now, accepted=accepted)
        if not self.stopped.is_set():
            self._due = self.loop.call_at(self._deadline, self._on_due)

    def _on_heartbeat(self) -> None:
        withheld = [axis.network for axis in self.axes if axis.withholds_heartbeat]
        for network in self.networks.values():
            if network not in withheld:
                network.send_heartbeat()
        for client in self.clients:
            if client.network not in withheld:
                client.heartbeat.request()
        self._beat = self.loop.call_later(self.buses.heartbeat_ns, self._on_heartbeat)

    def _cycle(self, now: int, *, accepted: bool) -> None:
        link = self.link
        self._pause.cycle(self._deadline, now)
        if self._together:
            self._take(together=False)
        # A gateway that stops needs no PLC any more.
        if (loss := link.poll(now)) and self._shutdown is None:
            log.error("PLC lost: %s", loss, extra={"event": "plc"})
            for item in self.objects:
                item.raise_fault(FaultNumber.PLC_LOST, loss, now)
        actuals, good = self._answer
        setpoints = link.setpoints
        for index, item in enumerate(self.objects):
            item.fresh = accepted
            given = setpoints[index]
            if (given is not None) is not item.supplied:
                self._note_supply(item, index, now)
            outputs = item.step(given, now)
            if item.stops:
                item.transmit(now)
            actuals[index] = outputs.actuals
            good[index] = outputs.good
        shutdown = self._shutdown
        if shutdown is not None:
            link.lose_setpoints()  # IOCS reports it
        self.cycles += 1
        answered = 0
        # Answer the PLC first, which waits for it; a drive waits only for the bus.
        if accepted or shutdown is not None or now - self._last_sent >= 2 * self.cycle_ns:
            link.send(actuals, good, now)
            self._last_sent = now
            answered = self.loop.now()
        for item in self.objects:
            if not item.stops:
                item.transmit(now)
        for producer in self.buses.sync_producers.values():
            producer.send()
        self.watch.cycle(now, accepted, answered, link.age_ns if accepted else None)
        self._await_next(now, accepted)
        if shutdown is not None and shutdown.step(now, alone=self.failure is None):
            self._finish()

    def _await_next(self, now: int, accepted: bool) -> None:
        """Set when the next cycle is due, and what the buses do until then."""
        cycle = self.cycle_ns
        expected = now + (max(cycle, IDLE_NS) if not accepted and self._idles() else cycle)
        deadline = self._deadline = expected + cycle // 2 if accepted else expected
        due = self._due
        if due is not None:
            if deadline < due.when:  # the gateway was idle
                due.cancel()
                self._due = self.loop.call_at(deadline, self._on_due)
            else:
                due.postpone(deadline)
        for network in self._networks:
            network.checks.run_before(expected)
        if (together := self.link.takes_together) or self._together:
            self._together = together
            for network in self._networks:
                network.listen(now, on=not together)
        self.loop.pace(expected)

    def _note_supply(self, item: DriveObject, index: int, now: int) -> None:
        """The setpoints of a drive object end, or come again."""
        item.supplied = not item.supplied
        if item.supplied:
            item.origins.returned(now)
        elif self.link.connected and self._shutdown is None and (finding := self.link.finding(index)) is not None:
            item.report_unusable(finding.evidence)

    def _idles(self) -> bool:
        """No PLC is connected, no drive has power, and none needs SYNC: a frame of the PLC is a cycle at once."""
        busy = self.link.connected or self._shutdown is not None or self.buses.sync_producers
        return not busy and not any(item.may_have_power for item in self.objects)
