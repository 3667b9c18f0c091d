"""The PLC's programs of calm days: tasks drawn at random, each of which has to end as it must within its time."""

from __future__ import annotations

import math
import uuid
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Final

from pdgw.base.durations import MS, SECOND
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.objects import VELOCITY_WINDOW
from pdgw.dsp402.states import UNPOWERED
from pdgw.dsp406.objects import UNITS_PER_REVOLUTION
from pdgw.gateway.axis.telegrams import (
    DSC_TELEGRAM_NUMBERS,
    ENCODER_TELEGRAM_NUMBERS,
    FLOAT_TELEGRAM_NUMBERS,
    POSITIONER_TELEGRAM_NUMBERS,
    TASK_TELEGRAM_NUMBERS,
)
from pdgw.gateway.client.udp import ParameterClient
from pdgw.peers.drive.model.ramps import INCREMENTS_PER_REVOLUTION
from pdgw.peers.encoder.motion import constant_speed, sine, still
from pdgw.peers.plc.exchange.following import PositionLoop
from pdgw.peers.world import WorldChannel
from pdgw.profidrive.datatypes import N2_100_PERCENT, N4_100_PERCENT, DataType, float_of, float_pattern
from pdgw.profidrive.parameters.codec import ParameterAddress, Values
from pdgw.profinet.rpc.client import RecordCaller
from pdgw.profinet.rpc.dcerpc import object_uuid
from tests.long.soak.plan import TRANSPARENT, habits_ms
from tests.long.soak.watch import RATED_RPM, ViolationError

if TYPE_CHECKING:
    from tests.long.soak.calm import CalmRun

_ONLINE_NS: Final = 60 * SECOND
"""Limit of a bring-up."""
_END_NS: Final = 5 * SECOND
"""Limit of a handshake, a ramp or a task, besides the latency of the drive and the time of the motion at its speed."""
_TASK, _JOG_1, _JOG_2, _HOMING = 0x0040, 0x0100, 0x0200, 0x0800
_NO_OFF3, _NO_REJECT, _NO_STOP, _RAMP_GENERATOR = 0x0004, 0x0010, 0x0020, 0x0070
_REACHED, _HOMED, _ACKNOWLEDGED = 0x0400, 0x0800, 0x1000
_ABSOLUTE, _PRESET, _PARK = 0x2000, 0x1000, 0x4000
"""Bits of G1_STW and G1_ZSW."""
_PRESET_PNU: Final = 65000
_LU_PER_REVOLUTION, _UNITS_PER_REVOLUTION, _FULL_VELOCITY = 10_000, 10, 30_000
"""Of the positioner (``plan.POSITIONER``): LU, units of telegram 112, and 3000 rpm in 1000 LU/min and in units/min."""
_SLOWEST: Final = 35
"""Increments per second of half a rpm, the smallest speed of the simulated drive."""
_RANGE: Final = 500_000
"""100 % of a position of telegram 9: 607Bh of the simulated drive. Without a range a position is in its units."""
_WINDOW: Final = 0.003
"""Revolutions, a little more than the ``position_window`` of the positioner."""
_DITHER: Final = 8
"""Increments that a shaft may be beside the home position when its load moves it."""
_BLOCKS: Final = {1: 2.0, 2: -3.0, 3: -0.5}
"""Ends of the traversing blocks, and of the chain that begins with block 3."""
_BLOCK_SHARE: Final = 0.2
_DEAD_TIMES: Final = {"late-pdos", "tpdo-jitter", "tpdo-inhibit", "command-latency"}
"""Habits with a dead time of the position loop of the PLC."""


class Program:
    """The program of one drive object. ``tasks``: what it draws from, by name."""

    def __init__(self, run: CalmRun) -> None:
        self.of = run
        self.loop = run.loop
        self.values = run.plc.endpoint.setpoints[0]
        self.chance = run.world.chance("program")
        self.done = 0
        self.task = "power-on"
        self.tasks: dict[str, Callable[[], None]] = {}

    def run(self) -> None:
        """Switch on, then run tasks without end: of every kind, or, as many machines do, of one kind."""
        self.power_on(_ONLINE_NS)
        names = list(self.tasks)
        if self.chance.random() < 0.5:
            names = [self.chance.choice(names)]
        self.of.working = True
        while True:
            self.task = self.chance.choice(names)
            self.of.trace.note(f"task: {self.task}")
            self.tasks[self.task]()
            self.done += 1
            self.pause(self.chance.choice((0, 1)))

    def power_on(self, limit_ns: int) -> None:
        """Wait for the drive object, and switch a drive on."""
        raise NotImplementedError

    def pause(self, longest: float = 1.0) -> None:
        """Wait up to this number of seconds."""
        self.loop.sleep(int(self.chance.uniform(0, longest) * SECOND))

    def ends(self, what: str, condition: Callable[[], bool], seconds: float = 0) -> None:
        """Each wait ends within its limit. ``seconds``: the time that a motion takes."""
        deadline = self.loop.now() + _END_NS + int(seconds * SECOND) + 4 * self.of.late_ns
        while not condition():
            if self.loop.now() > deadline:
                raise ViolationError(f"{self.task}: {what} does not end: {self.of.describe()}")
            self.loop.sleep(self.of.cycle_ns)

    def shown(self, name: str) -> int:
        """An actual value of the PLC; 0 without one."""
        values = self.of.plc.actuals[0]
        return 0 if values is None else values[name]

    def wait(self, name: str, bits: int, *, gone: bool = False) -> None:
        """Wait until a status word has these bits, or none of them."""
        self.ends(f"{name} {bits:04X}h {'0' if gone else '1'}", lambda: self.shown(name) & bits == bits * (not gone))

    def sensor(self, word: int, answer: int, rest: int = 0) -> None:
        """A request in G1_STW until its answer, and the word after it."""
        self.values["G1_STW"] = word
        self.wait("G1_ZSW", answer)
        self.values["G1_STW"] = rest
        self.wait("G1_ZSW", answer & ~rest, gone=True)
        self.wait("G1_ZSW", rest)

    def count(self, fewest: int, most: int) -> range:
        """A number of repetitions."""
        return range(self.chance.randrange(fewest, most))

    def period(self) -> float:
        """The period of a machine in seconds."""
        return math.exp(self.chance.uniform(math.log(0.3), math.log(5)))

    def speed(self) -> float:
        """A share of the full speed, also near 0, in one of both directions."""
        return math.copysign(math.exp(self.chance.uniform(math.log(0.01), 0)), self.chance.random() - 0.5)


class AxisProgram(Program):
    """With a control word and a drive."""

    def __init__(self, run: CalmRun) -> None:
        super().__init__(run)
        (self.axis,) = run.axes
        self.words = self.axis.words
        self.model = self.axis.drive.model
        self.tasks = {"off and on": self.off_and_on, "quick stop": self.quick_stop}

    def set(self, word: int) -> None:
        """Send another control word in one frame."""
        counters = self.of.plc.endpoint.counters
        self.words.set_word(word)
        last = counters["sent"] + 1
        while counters["sent"] < last:
            self.loop.sleep(self.of.cycle_ns)

    def begin(self) -> None:
        """Begin some motion."""
        raise NotImplementedError

    def power_on(self, limit_ns: int) -> None:
        name = "Statusword" if self.words.raw else "ZSW1"
        self.set(self.words.off)
        self.ends("ready to switch on", lambda: self.shown(name) & 0x4F == 0x01, limit_ns / SECOND)
        self.words.set_speed(0.0)
        self.set(self.words.on)
        self.ends("operation enabled", lambda: self.shown(name) & 0x4F == 0x07)

    def off_and_on(self) -> None:
        """OFF1 at standstill or in motion, and ON again."""
        if self.chance.random() < 0.5:
            self.begin()
            self.pause()
        self.of.working = False
        self.power_on(0)
        self.of.working = True

    def quick_stop(self) -> None:
        """OFF3 in motion, and ON again."""
        self.begin()
        self.pause()
        self.of.working = False
        self.set(self.words.on & ~_NO_OFF3)
        self.ends("quick stop", self.at_standstill)
        if self.words.raw:
            self.loop.sleep(self.of.late_ns)  # its brake closes
            self.set(0)  # a drive may stay in Quick Stop Active
        self.power_on(0)
        self.of.working = True

    def at_standstill(self) -> bool:
        """Whether the shaft is at standstill, or without power where its load turns it."""
        free = self.model.free_rpm and self.model.state in UNPOWERED
        return bool(free) or self.model.ramp.speed == 0

    def stop(self, word: int, on: int, *, started: bool = True) -> None:
        """Stop what has begun by a control word, after some time, and send another. ``started``: it must turn before."""
        if started:
            self.ends("start", lambda: not self.at_standstill())
        self.pause()
        self.set(word)
        self.loop.sleep(SECOND // 5)
        self.pause(0.8)
        self.ends("standstill", self.at_standstill)
        self.set(on)


class SpeedProgram(AxisProgram):
    """A speed setpoint."""

    def __init__(self, run: CalmRun) -> None:
        super().__init__(run)
        self.tasks |= {"to and fro": self.to_and_fro, "profile": self.profile, "stream": self.stream}
        if not self.words.raw and not isinstance(self, DscProgram):
            self.tasks["jog"] = self.jog
        if "G1_STW" in self.values:
            self.tasks["absolute value"] = lambda: self.sensor(_ABSOLUTE, _ABSOLUTE)

        if "MOMRED" in self.values:
            self.tasks["reduced torque"] = self.reduced_torque
        dither = self.axis.plan.habits.get("dithers", {"rpm": 0})["rpm"]
        self._dithers = dither > self.model.read(VELOCITY_WINDOW, 0) * self.model.unit

    def begin(self) -> None:
        self.words.set_speed(self.speed())

    def reduced_torque(self) -> None:
        """MOMRED has at most three quarters of the torque, also for the ramp down."""
        self.values["MOMRED"] = self.chance.randrange(N2_100_PERCENT * 3 // 4)
        self.to_and_fro()
        self.values["MOMRED"] = 0

    def follow(self, share: float) -> None:
        """The shaft turns with this speed, and the PLC sees it."""
        self.words.set_speed(share)
        self.ends(f"{share * RATED_RPM:.0f} rpm", lambda: self.of.follows(self.axis) and self.reached())

    def reached(self) -> bool:
        """ZSW1.10. A shaft that dithers beyond the drive's own velocity window shows it by chance."""
        return self.words.raw or self._dithers or bool(self.shown("ZSW1") & _REACHED)

    def turn(self, shares: Iterable[float], seconds: float) -> None:
        """Each of these speeds for the same time, then 0."""
        for share in shares:
            self.words.set_speed(share)
            self.loop.sleep(int(seconds * SECOND))
        self.follow(0.0)

    def to_and_fro(self) -> None:
        share = self.speed()
        self.turn((share * (-1) ** n for n in self.count(4, 24)), self.period() / 2)

    def stream(self) -> None:
        top, period, cycle = self.speed(), self.period(), self.of.cycle_ns / SECOND
        frames = range(int(2 * period / cycle))
        self.turn((top * math.sin(2 * math.pi * n * cycle / period) for n in frames), cycle)

    def profile(self) -> None:
        for _ in self.count(2, 7):
            self.follow(self.speed())
            self.pause()
        self.follow(0.0)

    def jog(self) -> None:
        on = self.words.on & ~_RAMP_GENERATOR
        bit, rpm = self.chance.choice(((_JOG_1, -150), (_JOG_2, 150)))
        self.set(on)
        self.set(on | bit)
        self.ends(f"{rpm} rpm", lambda: abs(self.model.ramp.speed - rpm) < 10)
        self.stop(on, self.words.on)


class DscProgram(SpeedProgram):
    """A position loop with DSC."""

    def __init__(self, run: CalmRun) -> None:
        super().__init__(run)
        if "slow-ramps" not in self.axis.plan.habits:  # with which a position loop of the PLC never comes to rest
            self.tasks["follow path"] = self.follow_path
        late = {name: values for name, values in self.axis.plan.habits.items() if name in _DEAD_TIMES}
        delay_s = (6 * run.cycle_ns + 2 * habits_ms(late) * MS) / SECOND
        gain, turn = min(20.0, 0.2 / delay_s), INCREMENTS_PER_REVOLUTION
        self.control = PositionLoop(gain, dsc=True, increments_per_revolution=turn, reference_rpm=RATED_RPM)
        self.path: Callable[[int], float] | None = None
        run.plc.before_frame.append(self._control)

    def _control(self, now: int) -> None:
        actuals = self.of.plc.endpoint.actuals[0]
        if self.path is not None and actuals is not None:
            self.values.update(self.control.step(self.path(now), actuals))

    def follow_path(self) -> None:
        start, begin, period = self.shown("G1_XIST1"), self.loop.now(), self.period()
        moves, way = self.chance.randrange(1, 8), self.chance.uniform(-0.3, 0.3) * period * RATED_RPM / 60
        way *= INCREMENTS_PER_REVOLUTION

        def path(now: int) -> float:
            phase = min((now - begin) / SECOND / period, moves / 2)
            return start + way * (1 - math.cos(2 * math.pi * phase)) / 2

        self.path = path
        near = 4 + _SLOWEST / self.control.gain
        self.loop.sleep(int(moves * period / 2 * SECOND))
        self.ends("position", lambda: abs(self.control.error) <= near, 15)
        self.path = None
        self.follow(0.0)


class RawProgram(SpeedProgram):
    """Telegram 100: the drive's own words, with a mode of operation for each task."""

    def __init__(self, run: CalmRun) -> None:
        super().__init__(run)
        self.tasks |= {"position": self.position, "home": self.home}

    def start(self, mode: Mode, seconds: float, condition: Callable[[], bool], bits: int) -> None:
        """Select a mode, give the edge of a new setpoint or homing, and wait for its answer and its end."""
        self.values["Modes of Operation"] = int(mode)
        self.ends(f"mode {mode}", lambda: self.shown("Modes of Operation Display") == mode)
        self.loop.sleep(self.of.late_ns)  # Statusword.12 is still that of the mode before
        self.set(self.words.on | _NO_REJECT)
        self.wait("Statusword", bits)
        self.set(self.words.on)
        self.ends("target", condition, seconds)

    def position(self) -> None:
        target, share = self.chance.randrange(-100_000, 100_000), self.chance.uniform(0.1, 1)
        seconds = abs(target - self.model.position) / INCREMENTS_PER_REVOLUTION / share / 50
        ramps = {"Profile Acceleration": 1000, "Profile Deceleration": 1000}
        self.values.update(ramps | {"Target Position": target, "Profile Velocity": max(1, int(6000 * share))})
        self.start(Mode.POSITION, 2 * seconds, lambda: self.at(target), _ACKNOWLEDGED)
        self.wait("Statusword", _ACKNOWLEDGED, gone=True)

    def at(self, target: float) -> bool:
        """Whether the axis has arrived: Statusword.10, the shaft, and the position that the PLC sees."""
        shown = abs(self.shown("Position Actual Value") - target) <= 1
        return bool(self.shown("Statusword") & _REACHED) and shown and self.at_standstill()

    def home(self) -> None:
        self.start(Mode.HOMING, 0, lambda: abs(self.model.position) <= _DITHER, _ACKNOWLEDGED | _REACHED)


class TaskProgram(AxisProgram):
    """Traversing tasks of telegrams 7, 9, 110, 111 and 112. Positions are revolutions."""

    def __init__(self, run: CalmRun) -> None:
        super().__init__(run)
        values = self.values
        number = self.words.telegram.number
        self.positioner = number in POSITIONER_TELEGRAM_NUMBERS
        self.suffix = "_F" if number in FLOAT_TELEGRAM_NUMBERS else ""
        self.mdi = "OVERRIDE" in values or not self.positioner
        self.selection = "POS_STW1" if "POS_STW1" in values else "SATZANW"
        self.tasks |= {"homing": self.homing, "rejected": self.rejected}
        if self.positioner:
            self.tasks |= {"jog": self.jog, "block": self.block}
        if self.mdi:
            self.tasks |= {"to and fro": self.to_and_fro, "relative": self.relative, "targets": self.targets}
            self.tasks["intermediate stop"] = self.intermediate_stop
        if self.selection == "POS_STW1":
            self.tasks |= {"setting up": self.setting_up, "update": self.update}
        if "OVERRIDE" in values:
            values["OVERRIDE"] = 0x4000
        if not self.positioner:
            values["SATZANW"] = 0x8000
        swing = self.axis.plan.habits.get("dithers", {"rpm": 0, "period_ms": 0})
        self.near = _WINDOW + 3 * swing["rpm"] * swing["period_ms"] / 60_000 / (2 * math.pi)
        """Revolutions. The place from which a relative task begins, the one seen before, and its end are any of a dither."""

    # -- units and values -------------------------------------------------------------------------------------------------

    def units(self, revolutions: float) -> float:
        """A position in the telegram's unit."""
        if not self.positioner:
            whole = N4_100_PERCENT if "position-range-none" in self.axis.plan.habits else _RANGE
            return revolutions * INCREMENTS_PER_REVOLUTION / whole * N4_100_PERCENT
        return revolutions * (_UNITS_PER_REVOLUTION if self.suffix else _LU_PER_REVOLUTION)

    def order(self, target: float, share: float, *, absolute: bool = True, more: int = 0) -> None:
        """The data of an MDI task. ``more``: further bits of POS_STW1."""
        percent = self.chance.uniform(20, 100)
        full = _FULL_VELOCITY if self.positioner else N4_100_PERCENT
        data = {"MDI_TARPOS": self.units(target), "MDI_VELOCITY": max(1.0, share * full)}
        if self.suffix:
            data |= {"MDI_ACC": percent, "MDI_DEC": percent}
            self.values.update({f"{name}_F": float_pattern(value) for name, value in data.items()})
        else:
            data |= dict.fromkeys(("MDI_ACC", "MDI_DEC"), percent * 0x4000 / 100)
            self.values.update({name: round(value) for name, value in data.items()})
        if "MDI_MOD" in self.values:
            self.values |= {"SATZANW": 0x8000, "MDI_MOD": int(absolute)}
        else:
            self.values["POS_STW1"] = 0x8000 | absolute << 8 | more

    def target(self) -> tuple[float, float]:
        """A position and a share of the full speed."""
        return self.chance.uniform(-20, 20), self.chance.uniform(0.05, 1)

    def begin(self) -> None:
        if self.mdi:
            self.start(*self.target())
        else:
            self.values[self.selection] = self.chance.choice(tuple(_BLOCKS))
            self.edge()

    def start(self, target: float, share: float, *, absolute: bool = True, more: int = 0) -> None:
        """Start an MDI task."""
        self.order(target, share, absolute=absolute, more=more)
        self.edge()

    def edge(self) -> None:
        """Start a task: STW1.6 falls, if it has not, for as short as the PLC may, or until the acknowledge falls."""
        fresh = self.chance.random() < 0.5
        if self.words.word & _TASK:
            self.set(self.words.on)
        if fresh:
            self.wait("ZSW1", _ACKNOWLEDGED, gone=True)
        self.set(self.words.on | _TASK)
        if fresh:
            self.wait("ZSW1", _ACKNOWLEDGED)
            self.set(self.words.on)

    def arrives(self, target: float, share: float) -> None:
        """The task ends at its target: ZSW1.10, the shaft, and the position that the PLC sees."""
        seconds = 2 * abs(self.where - target) / share / (RATED_RPM / 60)
        self.ends(f"target {target:.3f}", lambda: self.at(target), seconds)

    @property
    def where(self) -> float:
        """Position of the shaft."""
        return self.model.position / INCREMENTS_PER_REVOLUTION

    def at(self, target: float) -> bool:
        """Whether the axis has arrived."""
        near = abs(self.where - target) <= self.near and self.at_standstill()
        return near and bool(self.shown("ZSW1") & _REACHED) and self.shows(target)

    def shows(self, target: float) -> bool:
        """Whether the PLC sees this position."""
        if not self.mdi:
            return True
        raw = self.shown(f"XIST{self.suffix or '_A'}")
        return abs((float_of(raw) if self.suffix else raw) - self.units(target)) <= self.units(self.near)

    # -- tasks -----------------------------------------------------------------------------------------------------------

    def to_and_fro(self) -> None:
        start, share = self.target()
        ends, rest = (start, start + math.copysign(self.chance.uniform(0.1, 4), self.speed())), self.period() / 2
        for n in self.count(6, 24):
            self.start(ends[n % 2], share)
            self.arrives(ends[n % 2], share)
            self.pause(rest)

    def relative(self) -> None:
        for _ in self.count(1, 6):
            way, share = math.copysign(self.chance.uniform(0.1, 5), -self.where), abs(self.speed())
            target = self.where + way
            self.start(way, share, absolute=False)
            self.arrives(target, share)

    def targets(self) -> None:
        """Each task replaces the one before on its way."""
        for _ in self.count(1, 12):
            self.start(*self.target())
            self.pause(0.5)
        target = self.target()
        self.start(*target)
        self.arrives(*target)

    def intermediate_stop(self) -> None:
        target = self.target()
        self.start(*target)
        word = self.words.word
        self.stop(word & ~_NO_STOP, word, started=False)
        self.arrives(*target)

    def rejected(self) -> None:
        self.begin()
        self.stop(self.words.on & ~_NO_REJECT, self.words.on, started=False)

    def homing(self) -> None:
        if not self.positioner:
            self.values["SATZANW"] = 0x8000 | 35
        self.set(self.words.on)
        self.set(self.words.on | _HOMING)
        self.ends("homing", lambda: bool(self.shown("ZSW1") & _HOMED) and abs(self.where) <= _WINDOW and self.shows(0))
        self.set(self.words.on)

    def jog(self) -> None:
        self.set(self.words.on)
        self.set(self.words.on | self.chance.choice((_JOG_1, _JOG_2)))
        self.stop(self.words.on, self.words.on)

    def block(self) -> None:
        number = self.chance.choice(tuple(_BLOCKS))
        self.values[self.selection] = number
        self.edge()
        if self.words.word & _TASK:
            self.wait("ZSW1", _ACKNOWLEDGED)  # a chain may begin where it ends
        self.arrives(_BLOCKS[number], _BLOCK_SHARE)

    def setting_up(self) -> None:
        self.start(0.0, self.chance.uniform(0.02, 0.4), absolute=False, more=0x4200 if self.where < 0 else 0x4400)
        self.stop(self.words.on & ~_NO_REJECT, self.words.on)

    def update(self) -> None:
        """A stream of targets without edges."""
        target, share = self.target()
        self.set(self.words.on)
        self.order(target, share, more=0x1000)
        self.set(self.words.on | _TASK)
        for _ in self.count(2, 30):
            self.loop.sleep(self.chance.choice((1, 2, 5, 40)) * self.of.cycle_ns)
            target += self.chance.uniform(-1, 1)
            self.order(target, share, more=0x1000)
        self.arrives(target, share)


def _signed(difference: int, whole: int = 1 << 32) -> int:
    """The difference of two positions that wrap."""
    return (difference + whole // 2) % whole - whole // 2


class EncoderProgram(Program):
    """An encoder that turns and stops, with presets."""

    def __init__(self, run: CalmRun) -> None:
        super().__init__(run)
        assert run.encoder is not None
        self.model = run.encoder.model
        self.values.update({"STW2_ENC": 0x0400, "G1_STW": _ABSOLUTE})
        park = self.sensor
        self.tasks = {"preset": self.preset, "turn": self.turn, "park": lambda: park(_PARK, _PARK, _ABSOLUTE)}

    def power_on(self, limit_ns: int) -> None:
        self.ends("absolute value", lambda: bool(self.shown("G1_ZSW") & _ABSOLUTE), limit_ns / SECOND)

    def preset(self) -> None:
        """An absolute or relative preset at standstill."""
        self.model.set_motion(still(self.model.channels[1].mechanical))
        self.loop.sleep(SECOND // 5)
        before, counted = self.shown("G1_XIST2"), self.shown("G1_XIST1")
        relative = self.chance.random() < 0.5
        value = self.chance.randrange(1, 1_000_000)
        channel = WorldChannel(self.of.world, self.of.acyclic, "192.168.0.20")
        caller = RecordCaller(uuid.UUID(int=self.chance.getrandbits(128)), object_uuid(1, 0, 0))
        with ParameterClient(self.of.acyclic, 1, channel=channel, caller=caller, timeout_s=3) as client:
            (answer,) = client.request([ParameterAddress(_PRESET_PNU)], [Values(DataType.INTEGER32, (value,))])
        if answer.failed:
            raise ViolationError(f"P{_PRESET_PNU} is rejected: {answer.text}")
        self.sensor(_ABSOLUTE | _PRESET | relative << 11, _PRESET, _ABSOLUTE)
        expected = (before + value if relative else value) % self.model.chain.total_range
        near = 4 * self.model.noise
        whole = self.model.chain.total_range
        self.ends(f"position {expected}", lambda: abs(_signed(self.shown("G1_XIST2") - expected, whole)) <= near)
        if abs(_signed(self.shown("G1_XIST1") - counted)) > near:
            raise ViolationError(f"the preset moves G1_XIST1 from {counted} to {self.shown('G1_XIST1')}")

    def turn(self) -> None:
        """A constant speed is seen as NIST_B; then the encoder swings."""
        share, start = self.speed(), self.model.channels[1].mechanical
        self.model.set_motion(constant_speed(share * RATED_RPM / 60, start))
        asked = share * N4_100_PERCENT
        self.ends("speed", lambda: abs(self.speed_shown() - asked) <= 0.02 * N4_100_PERCENT, 10)
        self.pause(3)
        self.model.set_motion(sine(self.chance.uniform(0, 3), self.period(), self.model.channels[1].mechanical))
        self.pause(5)

    def speed_shown(self) -> float:
        """NIST_B, or without it the speed of G1_XIST1 in the same unit."""
        if "NIST_B" in self.of.plc.endpoint.telegrams[0].actuals.names:
            return self.shown("NIST_B")
        begin, before = self.next_position()
        self.loop.sleep(4 * SECOND)
        end, after = self.next_position()
        revolutions = _signed(after - before) / self.model.read(UNITS_PER_REVOLUTION, 0)
        return revolutions * SECOND / (end - begin) * 60 / RATED_RPM * N4_100_PERCENT

    def next_position(self) -> tuple[int, int]:
        """The time at which G1_XIST1 changes, and its new value. It may be read by SDO, so it is as old as the last reading."""
        before = self.shown("G1_XIST1")
        self.ends("motion", lambda: self.shown("G1_XIST1") != before)
        return self.loop.now(), self.shown("G1_XIST1")


def program(run: CalmRun) -> Program:
    """The program of a part."""
    number = run.plan.telegrams[0].number
    if number in ENCODER_TELEGRAM_NUMBERS:
        return EncoderProgram(run)
    if number in TASK_TELEGRAM_NUMBERS:
        return TaskProgram(run)
    if number in DSC_TELEGRAM_NUMBERS:
        return DscProgram(run)
    return RawProgram(run) if number == TRANSPARENT else SpeedProgram(run)
