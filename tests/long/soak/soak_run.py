"""One part of a soak day: a gateway in its world, a PLC with random commands, disturbances, and calm periods to recover."""

from __future__ import annotations

import logging
import math
import shutil
import tempfile
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from random import Random
from typing import ClassVar, Final

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.communication import EMCY
from pdgw.ds301.node.node import NodeStatus
from pdgw.ds301.pdo import PdoDirection
from pdgw.dsp402.states import State
from pdgw.gateway.axis.telegrams import TASK_TELEGRAM_NUMBERS
from pdgw.gateway.base.udp import Address
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.environment import TraceConfig
from pdgw.gateway.daemon.assembly import build_gateway
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.trace.reader import RingReader
from pdgw.gateway.trace.recorder import FlightRecorder
from pdgw.peers.drive import LINEAR_AXIS, ROTARY_AXIS, Machine, shape
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.peers.plc.exchange.plc import Plc
from pdgw.peers.world import Conditions, Member, SimulatedCan, World
from pdgw.profidrive.frame import IOPS_GOOD, STATUS_RUN, CSduLayout
from pdgw.profidrive.telegrams import Direction, Telegram, telegram
from pdgw.tools.recording.recordings import replayed
from tests.long.rules import Seen
from tests.long.soak.disturbances import DISTURBANCES, PLC_HOST, UNPLUGGED, Disturbance, Undo
from tests.long.soak.emcy_check import PendingEmcys
from tests.long.soak.engineer import HOST as ENGINEER_HOST
from tests.long.soak.engineer import Engineer
from tests.long.soak.plan import AxisPlan, Part, Plan, shapes_of
from tests.long.soak.trace import Trace
from tests.long.soak.watch import RATED_RPM, REACHED_RPM, TRANSIENT_NS, SoakAxis, ViolationError, require
from tests.long.soak.words import ACKNOWLEDGE, Words, asked_share, shown_share
from tests.support.gateways.fault_display import drive_state

CHANNEL: Final = "soak"
_CHECK_NS: Final = 25 * MS
_RPDOS: Final = frozenset(base + node for base in PdoDirection.RPDO.bases[:4] for node in range(1, 128))
_NODE: Final = 0x7F
_STATUS_OFFSET: Final = -2
"""Position of the data status, from the end of a frame."""
_BACK_NS: Final = 20 * SECOND
"""In a calm period every axis is in operation again within this time."""
_FOLLOW_NS: Final = 10 * SECOND
"""Then its shaft turns with the commanded speed within this time."""
_FOLLOW_WORD_NS: Final = 250 * MS
"""Time for an axis to follow a word in a calm period, besides twice the latency of its drive."""
_PAUSE_NS: Final = 600 * MS
"""Mean time between two disturbances."""
_ACT_NS: Final = 4 * SECOND
"""Mean time between two uses of the parameter channel."""
_SHORTEST_NS, _LONGEST_NS = 2 * MS, 3 * SECOND
_CHAOS_S: Final = (5, 30)
_TIMERS_MAX: Final = 2000
_FRAMES_UNDER_WAY: Final = 1000
"""More frames than the PLC sends during the longest delay."""
_WHOLE: Final = TraceConfig(seconds=3600, megabytes=1024)
"""The recording of a part from its start."""
_IDENTITY: Final = "drive: wrong-identity"
"""Without a data sheet a gateway accepts the first identity it reads, so this fault needs a data sheet."""
_REACTION_CYCLES: Final = 2
"""The cycle of the frame, and that of a late step."""
_PLAIN: Final = Conditions()
_CHANGES: Final = 0.3
"""Share of the calm periods with a change of a telegram."""


class SoakRun:
    """Runs one part of a day. ``keep_telegrams``: the PLC changes none. ``frames``: the trace has every CAN frame.

    ``records``: each gateway records itself, for ``replayed``.
    """

    linear: ClassVar[Machine] = LINEAR_AXIS
    """The machine of an axis with tasks."""

    def __init__(
        self, part: Part, *, keep_telegrams: bool = False, frames: bool = False, records: bool = False
    ) -> None:
        self.begin = part.begin
        self.world: World = World(part.world_seed, self.begin)
        self.loop = self.world.loop
        self.trace = Trace(self.loop.now, frames=frames)
        self.calm = True
        self.plan: Plan = part.plan
        self._folder = Path(tempfile.mkdtemp())
        """Of the parameter store, which one gateway after the other uses."""
        # Not of this object: a compiled class allows no weak references.
        weakref.finalize(self.world, shutil.rmtree, self._folder)
        self._records = records
        self._recorders: list[FlightRecorder] = []
        """One for each gateway."""
        self._config = self._configuration()
        self._may_change_telegrams = not keep_telegrams
        self.daemon = self._gateway()
        self.cycle_ns = self.daemon.cycle_ns
        self._watchdog_ns = self.cycle_ns * self._config.transport.watchdog_factor
        telegrams = self.plan.telegrams
        port = self.world.network.open(PLC_HOST, 0, "PLC")
        self.plc: Plc = Plc(self.loop, port, self.daemon.address, telegrams, self.cycle_ns)
        self._layout = CSduLayout(telegrams, Direction.SETPOINT)
        self.axes = [self._axis(index, item) for index, item in enumerate(self.plan.axes)]
        self.pending = [PendingEmcys(axis.name) for axis in self.axes]
        self._chance = self.world.chance("troubles")
        self.acyclic = (self.daemon.address[0], self._config.transport.acyclic_port)
        """Address of the parameter channel."""
        self._engineer = Engineer(self.world, self.acyclic, self.world.chance("engineer"))
        self._active: dict[str, tuple[Disturbance, SoakAxis, Undo]] = {}
        self._quiet_since = self.begin
        self._arrived = self.begin
        self._newest: tuple[Address, int] | None = None
        """Sender and time of the newest frame of the PLC that arrived."""
        self._sent: dict[bytes, int] = {}
        """Send times of the last frames of the PLC."""
        self._runs = False
        self._violation: ViolationError | None = None
        self.world.network.taps.append(self._on_sent)
        self.world.network.arrivals.append(self._on_arrival)
        self.bus.offered.append(self._on_offered)
        self.bus.taps.append(self._on_frame)
        self.trace.note(str(self.plan))

    def _configuration(self) -> GatewayConfig:
        config = self.plan.configuration(CHANNEL, PLC_HOST, ENGINEER_HOST)
        return config.model_copy(update={"store": self._folder / "store.json", "trace": _WHOLE})

    def _gateway(self) -> Daemon:
        daemon = build_gateway(self._config, self.world)
        if self._records:
            self._recorders.append(FlightRecorder(daemon, self._folder, f"gateway-{len(self._recorders)}"))
            daemon.services.append(self._recorders[-1])
        self._origin = self.loop.now()
        return daemon

    def _axis(self, index: int, plan: AxisPlan) -> SoakAxis:
        number = plan.telegram
        machine = self.linear if number in TASK_TELEGRAM_NUMBERS else ROTARY_AXIS
        drive = self.world.drive(
            CHANNEL, index + 1, shape=shape(plan.shape), latency=plan.latency, machine=machine, habits=plan.habits
        )
        assert isinstance(drive.port, Member)
        words = Words(telegram(number), self.world.chance(f"words {index}"), self.cycle_ns)
        axis = SoakAxis(index, plan, drive, drive.port, words)
        axis.in_force_ns = self._watchdog_ns + 2 * self.cycle_ns
        axis.reaction_ns = _REACTION_CYCLES * self.cycle_ns + _CHECK_NS
        self.plc.endpoint.setpoints[index] = words.values
        drive.model.watchers.append(lambda state: self.trace.note(f"{axis.name}: drive in {state.value}"))
        return axis

    @property
    def bus(self) -> SimulatedCan:
        """The only CAN bus."""
        return self.world.bus(CHANNEL)

    @property
    def gateway_port(self) -> Member:
        """The gateway's controller on the bus."""
        return self.world.gateway_port(CHANNEL)

    @property
    def starts(self) -> int:
        """Number of drive starts."""
        return sum(axis.starts for axis in self.axes)

    # -- running ------------------------------------------------------------------------------------------------------

    def close(self) -> None:
        """End this world; otherwise its waiting tasks would keep it in memory."""
        for recorder in self._recorders:
            recorder.stop()
        self.loop.close()

    def replayed(self) -> int:
        """Replay what the gateways have recorded; the number of steps. ViolationError for the first difference."""
        count = 0
        for recorder in self._recorders:
            reader = RingReader(recorder.path)
            for result in replayed([str(path) for path in reader.segments()]):
                count += result.steps
                if result.differences:
                    raise ViolationError(f"replayed otherwise: {result.differences[0]}")
        return count

    def run_to(self, until: int) -> None:
        """Run until a time of the day. ViolationError when a safety rule is violated."""
        with _logging_to(self.trace):
            if self.loop.now() == self.begin:
                self.daemon.start()
                self.plc.start()
                self.loop.spawn(self._phases, "phases")
                self.loop.spawn(self._use_parameters, "engineer")
                self._check()
                for axis in self.axes:
                    self._talk(axis)
                self._disturb()
            while self.loop.now() < until:
                self.loop.run_until(min(until, self.loop.now() + SECOND))
                if self._violation is not None:
                    raise self._violation
                if self.loop.task_errors:
                    raise ViolationError("a task of the gateway ended with an error")
                if self.loop.waiting > _TIMERS_MAX:
                    raise ViolationError(f"{self.loop.waiting} timers wait: they only grow")

    def _phases(self) -> None:
        chance = self.world.chance("phases")
        try:
            while True:
                self._all_back()
                self._follow(chance)
                if self._may_change_telegrams and chance.random() < _CHANGES:
                    self._change_telegram(chance)
                    self._all_back()
                self.calm = False
                self.loop.sleep(int(chance.uniform(*_CHAOS_S) * SECOND))
                self.calm = True
                for name in list(self._active):
                    self._end(name)
        except ViolationError as violation:
            self._violation = violation

    def _all_back(self) -> None:
        """In a calm period, OFF, acknowledge and ON bring every axis into operation."""
        self.trace.note("calm: all axes have to operate")
        deadline = self.loop.now() + _BACK_NS
        for axis in self.axes:
            axis.drive.do(lambda node: node.model.clear())
        while True:
            self._send_word(lambda axis: axis.words.off)
            while not all(self.ready(axis) for axis in self.axes):
                self._send_word(lambda axis: axis.words.off | ACKNOWLEDGE)
                self._send_word(lambda axis: axis.words.off)
                require("calm", Seen(stuck=self.loop.now() > deadline), self.describe())
            self._send_word(lambda axis: axis.words.off | 0x07)
            self._send_word(lambda axis: axis.words.on)
            if all(axis.drive.model.state is State.OPERATION_ENABLED for axis in self.axes):
                return

    def _follow(self, chance: Random) -> None:
        """In a calm period, the shaft turns with the commanded speed and the PLC sees it."""
        turning = [axis for axis in self.axes if axis.words.set_speed(0.0)]
        self._wait()  # an axis at a limit needs the setpoint 0
        for axis in turning:
            axis.words.set_speed(math.copysign(chance.uniform(0.02, 0.8), -axis.drive.model.machine_position))
        deadline = self.loop.now() + _FOLLOW_NS
        again = True
        while turning := [axis for axis in turning if not self.follows(axis)]:
            if again and any(axis.drive.model.state is not State.OPERATION_ENABLED for axis in turning):
                # A drive may report once, while it turns, that it cannot do something.
                again = False
                self._all_back()
                deadline = self.loop.now() + _FOLLOW_NS
            axis = turning[0]
            asked = (asked_share(axis.words.values) or 0.0) * RATED_RPM
            details = f"asked {asked:.0f} rpm, turns {axis.drive.model.ramp.speed:.0f} rpm"
            shown = f"{details}, shown {self.plc.endpoint.actuals[axis.index]}"
            require(axis.name, Seen(apart=self.loop.now() > deadline), shown)
            self.loop.sleep(_FOLLOW_WORD_NS)

    def follows(self, axis: SoakAxis) -> bool:
        rpm = axis.drive.model.ramp.speed
        asked = (asked_share(axis.words.values) or 0.0) * RATED_RPM
        shown = shown_share(self.plc.endpoint.actuals[axis.index])
        right = shown is None or abs(shown * RATED_RPM - rpm) <= REACHED_RPM / 3
        return abs(rpm - asked) <= REACHED_RPM / 3 and right

    def _change_telegram(self, chance: Random) -> None:
        """Write P922 of one axis out of operation, and restart the PLC with the matching frame."""
        axis = chance.choice(self.axes)
        before = axis.words.telegram.number
        fitting = [
            n
            for n in self._config.axis[axis.index].telegrams
            if n != before and axis.plan.shape in shapes_of(n) and self.plan.with_telegram(axis.index, n).fits_bus
        ]
        if not fitting:
            return
        for other in self.axes:
            other.words.set_speed(0.0)
        self._send_word(lambda axis: axis.words.off)
        self.loop.sleep(3 * SECOND)
        number = chance.choice(fitting)
        done = self._engineer.select(axis.index + 1, number, PLC_HOST)
        self.trace.note(f"{axis.name}: P922 := {number}: {'taken' if done else 'refused'}")
        if done:
            axis.change(Words(telegram(number), axis.words.chance, self.cycle_ns))
            self.plan = self.plan.with_telegram(axis.index, number)
            self._config = self._configuration()
            telegrams = [item.words.telegram for item in self.axes]
            self._layout = CSduLayout(telegrams, Direction.SETPOINT)
            self.restart_plc(telegrams)
            for item in self.axes:
                item.require_new_off("telegram changed")
                self.plc.endpoint.setpoints[item.index] = item.words.values

    def _send_word(self, word: Callable[[SoakAxis], int]) -> None:
        """Send a word to every axis, and wait until they follow."""
        for axis in self.axes:
            axis.words.set_word(word(axis))
        self._wait()

    def _wait(self) -> None:
        """Wait for the time that every axis has to follow."""
        self.loop.sleep(_FOLLOW_WORD_NS + 2 * max(axis.late_ns for axis in self.axes) + 4 * self.cycle_ns)

    def _shown(self, axis: SoakAxis) -> int | None:
        """ZSW1 if the telegram has it and it is valid."""
        word = -1 if axis.words.raw else self.plc.value("ZSW1", axis.index)
        return None if word < 0 else word

    def ready(self, axis: SoakAxis) -> bool:
        if axis.words.raw:
            return axis.drive.model.state is State.READY_TO_SWITCH_ON
        shown = self._shown(axis)
        return shown is not None and drive_state(shown) == 1

    def describe(self) -> str:
        """States and reasons of all axes."""
        return "; ".join(
            f"{axis.name}: drive in {axis.drive.model.state.value}, {item.reason.value if item.reason else 'no reason'}, "
            f"{item.client.status_text}"
            for axis, item in zip(self.axes, self.daemon.axes, strict=True)
        )

    # -- the PLC ------------------------------------------------------------------------------------------------------

    def _talk(self, axis: SoakAxis) -> None:
        if not self.calm:
            before = axis.words.word
            axis.words.draw()
            if axis.words.word != before:
                self.trace.note(f"{axis.name}: PLC {axis.words.name} {axis.words.word:04X}h")
        self.loop.call_later(axis.words.word_duration_ns(), lambda: self._talk(axis))

    def restart_plc(self, telegrams: Sequence[Telegram] | None = None) -> None:
        """Restart the PLC: another port, a new relationship, the same setpoints. Other telegrams start with zeros."""
        plc, before = self.plc, self.plc.endpoint
        plc.port.close()
        plc.endpoint = PlcEndpoint(before.telegrams if telegrams is None else telegrams, self.cycle_ns)
        if telegrams is None:
            plc.endpoint.setpoints = before.setpoints
        plc.port = self.world.network.open(PLC_HOST, 0, "PLC")
        plc.port.start(plc.receive)

    def restart_gateway(self) -> None:
        """Restart a gateway that ended, for example because of another master on its bus."""
        if self.daemon.stopped.is_set() and UNPLUGGED not in self._active:
            self.trace.note(f"gateway ended ({self.daemon.failure}) and starts again")
            self._end(_IDENTITY)
            for axis in self.axes:
                axis.restarted()
            for pending in self.pending:
                pending.waiting.clear()
            self.daemon = self._gateway()
            self.daemon.start()

    def _use_parameters(self) -> None:
        chance = self.world.chance("parameters")
        act_at = self.loop.now() + _exponential(chance, _ACT_NS)
        try:
            while True:
                self.loop.sleep(SECOND)
                for axis, pending in zip(self.axes, self.pending, strict=True):
                    if pending.due(self.loop.now()):
                        history = self.daemon.axes[axis.index].fault_log.history
                        self._engineer.look(axis.index + 1, pending, self._origin, history)
                if self.loop.now() >= act_at:
                    axis = chance.choice(self.axes)
                    did = self._engineer.act(axis.index + 1)
                    self.trace.note(f"{axis.name}: engineer, {did}")
                    act_at = self.loop.now() + _exponential(chance, _ACT_NS)
        except ViolationError as violation:
            self._violation = violation

    def _on_sent(self, now: int, source: Address, target: Address, data: bytes) -> None:
        if target == self.daemon.address and source[0] == PLC_HOST:
            sent = self._sent
            sent[data] = now
            if len(sent) > _FRAMES_UNDER_WAY:
                del sent[next(iter(sent))]

    def _on_arrival(self, now: int, source: Address, target: Address, data: bytes) -> None:
        if target != self.daemon.address or source[0] != PLC_HOST or len(data) != self._layout.frame_size:
            return
        self._check_gap(now)
        self._arrived = now
        sent = self._sent.get(data, now)
        stale = self._newest is not None and source == self._newest[0] and sent <= self._newest[1]
        if stale:
            self._quiet_since = now  # delayed frames still arrive between the new ones
        else:
            self._newest = source, sent
        self._runs = bool(data[_STATUS_OFFSET] & STATUS_RUN)
        layout = self._layout
        undisturbed = self.world.network.conditions == _PLAIN and now - self._quiet_since > self._watchdog_ns
        certain = undisturbed and not stale
        for axis in self.axes:
            iops = layout.iops[axis.index]
            axis.good = self._runs and bool(data[iops] & IOPS_GOOD)
            if axis.good:
                axis.asked(now, bytes(data[layout.offsets[axis.index] : iops]), certain=certain)
            elif certain:
                axis.require_new_off("IOPS BAD" if self._runs else "provider STOP")

    def _check_gap(self, now: int) -> None:
        if now - self._arrived > self._watchdog_ns:
            for axis in self.axes:
                axis.require_new_off("PLC lost", self._arrived + self._watchdog_ns)

    # -- disturbances -------------------------------------------------------------------------------------------------

    def _disturb(self) -> None:
        chance = self._chance
        if not self.calm:
            (disturbance,) = chance.choices(DISTURBANCES, [item.weight for item in DISTURBANCES])
            axis = chance.choice(self.axes)
            duration = int(math.exp(chance.uniform(math.log(_SHORTEST_NS), math.log(_LONGEST_NS))))
            unknown = disturbance.name == _IDENTITY and not all(item.client.generation for item in self.daemon.axes)
            if disturbance.name not in self._active and not unknown:
                self.begin_disturbance(disturbance, axis, duration)
        self.loop.call_later(_exponential(chance, _PAUSE_NS), self._disturb)

    def begin_disturbance(self, disturbance: Disturbance, axis: SoakAxis, duration: int) -> None:
        """Start a disturbance that is not active already; ``duration`` in nanoseconds."""
        self.trace.note(f"{axis.name}: {disturbance.name} for {duration / MS:.0f} ms")
        self._active[disturbance.name] = (disturbance, axis, disturbance.begin(self, axis, self._chance))
        self.loop.call_later(duration, lambda: self._end(disturbance.name))

    def _end(self, name: str) -> None:
        entry = self._active.pop(name, None)
        if entry is not None:
            self.trace.note(f"{entry[1].name}: {name} ends")
            entry[2]()
            self._touch(entry[0], entry[1])

    def _touch(self, disturbance: Disturbance, axis: SoakAxis) -> None:
        self._quiet_since = self.loop.now()
        if disturbance.drive:
            axis.disturbed()

    # -- observation --------------------------------------------------------------------------------------------------

    def _check(self) -> None:
        now = self.loop.now()
        for disturbance, axis, _ in self._active.values():
            self._touch(disturbance, axis)
        self._check_gap(now)
        self.restart_gateway()
        quiet = now - self._quiet_since > TRANSIENT_NS
        plc_there = self._runs and now - self._arrived <= self._watchdog_ns + self.cycle_ns
        port = self.gateway_port
        bus_there = port.connected and not port.bus_off and not self.bus.shorted
        for axis, item in zip(self.axes, self.daemon.axes, strict=True):
            online = item.client.status is NodeStatus.ONLINE
            if not online:
                axis.require_new_off("drive not online")
            reached = plc_there and bus_there and online and axis.member.connected and axis.good
            axis.check(now, reached=reached, zsw1=self._shown(axis) if quiet and reached else None)
        self.loop.call_later(_CHECK_NS, self._check)

    def _on_offered(self, now: int, sender: Member, can_id: int, data: bytes) -> None:
        node = can_id & _NODE
        if sender.name == "gateway" and can_id in _RPDOS and 0 < node <= len(self.axes):
            axis = self.axes[node - 1]
            controlword = axis.controlword_in(can_id, data)
            if controlword is not None:
                axis.commanded(now, controlword)

    def _on_frame(self, now: int, sender: Member, can_id: int, data: bytes) -> None:
        node = can_id - EMCY
        if 0 < node <= len(self.axes) and len(data) == 8:
            with suppress(KeyError):  # no gateway on the bus yet
                port = self.gateway_port
                if port.connected and not port.bus_off and not port.closed:
                    present = self.daemon.axes[node - 1].fault_log.unacknowledged()
                    self.pending[node - 1].sent(now, data, {record.code for record in present})
        if self.trace.frames:
            self.trace.note(f"CAN {sender.name}: {can_id:03X}h {data.hex(' ')}")


def _exponential(chance: Random, mean: int) -> int:
    return int(chance.expovariate(1 / mean))


@contextmanager
def _logging_to(trace: Trace) -> Iterator[None]:
    """Write the gateway's log only to the trace."""
    loggers = [logging.getLogger(name) for name in ("gateway", "canopen")]
    before = [(logger.level, logger.propagate) for logger in loggers]
    loggers[0].addHandler(trace)
    loggers[0].setLevel(logging.INFO)
    loggers[1].setLevel(logging.CRITICAL)
    loggers[0].propagate = False
    try:
        yield
    finally:
        loggers[0].removeHandler(trace)
        for logger, (level, propagate) in zip(loggers, before, strict=True):
            logger.setLevel(level)
            logger.propagate = propagate
