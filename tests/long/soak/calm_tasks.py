"""The PLC's programs of calm days: tasks drawn at random, each of which has to end as it must within its time."""

from __future__ import annotations

import math
import uuid
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from pdgw.client.udp import ParameterClient
from pdgw.dsp402.modes import Mode
from pdgw.durations import SECOND
from pdgw.gateway.axis.telegrams import (
    DSC_TELEGRAM_NUMBERS,
    ENCODER_TELEGRAM_NUMBERS,
    FLOAT_TELEGRAM_NUMBERS,
    POSITIONER_TELEGRAM_NUMBERS,
    TASK_TELEGRAM_NUMBERS,
)
from pdgw.peers.drive.model.motion import INCREMENTS_PER_REVOLUTION
from pdgw.peers.encoder.motion import constant_speed, sine, still
from pdgw.peers.plc.exchange.following import PositionLoop
from pdgw.peers.world import WorldChannel
from pdgw.profidrive.datatypes import N4_100_PERCENT, DataType
from pdgw.profidrive.parameters.codec import ParameterAddress, Values
from pdgw.profidrive.signals import float_of, float_pattern
from tests.long.soak.plan import TRANSPARENT
from tests.long.soak.watch import RATED_RPM, ViolationError

if TYPE_CHECKING:
    from tests.long.soak.calm import CalmRun

_ONLINE_NS: Final = 60 * SECOND
"""Limit of a bring-up."""
_END_NS: Final = 5 * SECOND
"""Limit of a handshake, a ramp or a task, besides the latency of the drive and the time of the motion at its speed."""
_TASK, _JOG_1, _JOG_2, _HOMING = 0x0040, 0x0100, 0x0200, 0x0800
_NO_REJECT, _NO_STOP = 0x0010, 0x0020
_REACHED, _HOMED, _ACKNOWLEDGED = 0x0400, 0x0800, 0x1000
_ABSOLUTE, _PRESET, _PARK = 0x2000, 0x1000, 0x4000
"""Bits of G1_STW and G1_ZSW."""
_PRESET_PNU: Final = 65000
_LU_PER_REVOLUTION, _UNITS_PER_REVOLUTION, _FULL_VELOCITY = 10_000, 10, 30_000
"""Of the positioner (``plan.POSITIONER``): LU, units of telegram 112, and 3000 rpm in 1000 LU/min and in units/min."""
_SLOWEST: Final = 35
"""Increments per second of half a rpm, the smallest speed of the simulated drive."""
_RANGE: Final = 500_000
"""100 % of a position of telegram 9: 607Bh of the simulated drive."""
_WINDOW: Final = 0.003
"""Revolutions, a little more than the ``position_window`` of the positioner."""
_BLOCKS: Final = {1: 2.0, 2: -3.0, 3: -0.5}
"""Ends of the traversing blocks, and of the chain that begins with block 3."""
_BLOCK_SHARE: Final = 0.2


class Program:
    """The program of one drive object. ``tasks``: what it draws from."""

    def __init__(self, run: CalmRun) -> None:
        self.of = run
        self.values = run.plc.endpoint.setpoints[0]
        self.chance = run.world.chance("program")
        self.done = 0
        self.task = "power-on"
        self.tasks: tuple[Callable[[], None], ...] = ()

    def shown(self, name: str) -> int:
        """An actual value of the PLC; 0 without one."""
        return self.of.plc.value(name) or 0

    def run(self) -> None:
        """Switch on, then run tasks without end: of every kind, or, as many machines do, of one kind."""
        self.power_on()
        if self.chance.random() < 0.5:
            self.tasks = (self.chance.choice(self.tasks),)
        self.of.working = True
        while True:
            task = self.chance.choice(self.tasks)
            self.task = task.__name__.replace("_", " ")
            self.of.trace.note(f"task: {self.task}")
            task()
            self.done += 1
            self.sleep(self.chance.choice((0, self.chance.uniform(0, 1))))

    def power_on(self) -> None:
        """Wait for the drive object, and switch a drive on."""
        raise NotImplementedError

    def sleep(self, seconds: float) -> None:
        """Wait without a condition."""
        self.of.loop.sleep(int(seconds * SECOND))

    def ends(self, what: str, condition: Callable[[], bool], limit_ns: int = _END_NS) -> None:
        """Each wait ends within its limit."""
        loop = self.of.loop
        deadline = loop.now() + limit_ns + 4 * self.of.late_ns
        while not condition():
            if loop.now() > deadline:
                raise ViolationError(f"{self.task}: {what} does not end: {self.of.describe()}")
            loop.sleep(self.of.cycle_ns)

    def wait_bits(self, what: str, name: str, bits: int, *, gone: bool = False) -> None:
        """Wait until a status word has these bits, or none of them."""
        self.ends(what, lambda: self.shown(name) & bits == (0 if gone else bits))

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

    def set(self, word: int) -> None:
        """Send another control word in one frame."""
        counters = self.of.plc.endpoint.counters
        self.words.set_word(word)
        last = counters["sent"] + 1
        while counters["sent"] < last:
            self.of.loop.sleep(self.of.cycle_ns)

    def begin(self) -> None:
        """Begin some motion."""
        raise NotImplementedError

    def idle(self) -> None:
        """Set setpoints that move nothing."""

    def power_on(self, limit_ns: int = _ONLINE_NS) -> None:
        name = "Statusword" if self.words.raw else "ZSW1"
        self.set(self.words.off)
        self.ends("ready to switch on", lambda: self.shown(name) & 0x4F == 0x01, limit_ns)
        self.idle()
        self.set(self.words.on)
        self.ends("operation enabled", lambda: self.shown(name) & 0x4F == 0x07)

    def off_and_on(self) -> None:
        """OFF1 at standstill or in motion, and ON again."""
        if self.chance.random() < 0.5:
            self.begin()
            self.sleep(self.chance.random())
        self.of.working = False
        self.power_on(_END_NS)
        self.of.working = True

    def stands(self) -> bool:
        """The shaft is at standstill."""
        return self.model.ramp.speed == 0

    def until(self, begin: int, seconds: float) -> None:
        """Wait for the rest of a machine's period."""
        self.of.loop.sleep(max(self.of.cycle_ns, begin + int(seconds * SECOND) - self.of.loop.now()))


class SpeedProgram(AxisProgram):
    """A speed setpoint."""

    def __init__(self, run: CalmRun) -> None:
        super().__init__(run)
        self.tasks = (self.to_and_fro, self.profile, self.stream, self.jog, self.off_and_on)
        if "G1_STW" in self.values:
            self.tasks += (self.absolute_value,)

    def begin(self) -> None:
        self.words.set_speed(self.speed())

    def idle(self) -> None:
        self.words.set_speed(0.0)

    def follows(self, share: float) -> None:
        """The shaft turns with this speed, and the PLC sees it."""
        self.words.set_speed(share)
        self.ends(f"{share * RATED_RPM:.0f} rpm", lambda: self.of.follows(self.axis) and self.reached())

    def reached(self) -> bool:
        """ZSW1.10."""
        return self.words.raw or bool(self.shown("ZSW1") & _REACHED)

    def to_and_fro(self) -> None:
        period, share = self.period(), self.speed()
        for _ in range(self.chance.randrange(4, 24)):
            self.words.set_speed(share)
            self.sleep(period / 2)
            share = -share
        self.follows(0.0)

    def profile(self) -> None:
        for _ in range(self.chance.randrange(2, 7)):
            self.follows(self.speed())
            self.sleep(self.chance.random())
        self.follows(0.0)

    def stream(self) -> None:
        begin, period, top = self.of.loop.now(), self.period(), self.speed()
        while self.of.loop.now() - begin < 2 * period * SECOND:
            self.words.set_speed(top * math.sin(2 * math.pi * (self.of.loop.now() - begin) / SECOND / period))
            self.of.loop.sleep(self.of.cycle_ns)
        self.follows(0.0)

    def jog(self) -> None:
        bit, rpm = self.chance.choice(((_JOG_1, -150), (_JOG_2, 150)))
        self.set(self.words.on & ~0x70)
        self.set(self.words.on & ~0x70 | bit)
        self.ends(f"{rpm} rpm", lambda: abs(self.model.ramp.speed - rpm) < 10)
        self.sleep(self.chance.random())
        self.set(self.words.on & ~0x70)
        self.ends("standstill", self.stands)
        self.set(self.words.on)

    def absolute_value(self) -> None:
        self.values["G1_STW"] = _ABSOLUTE
        self.wait_bits("absolute value", "G1_ZSW", _ABSOLUTE)
        self.values["G1_STW"] = 0
        self.wait_bits("end of the absolute value", "G1_ZSW", _ABSOLUTE, gone=True)


class DscProgram(SpeedProgram):
    """A position loop with DSC."""

    def __init__(self, run: CalmRun) -> None:
        super().__init__(run)
        own = (self.follow_path, self.follow_path, self.follow_path)
        self.tasks = (*own, *(task for task in self.tasks if task != self.jog))  # without the telegram's own jog
        delay_s = (6 * run.cycle_ns + run.late_ns) / SECOND
        gain, turn = min(20.0, 0.2 / delay_s), INCREMENTS_PER_REVOLUTION
        self.loop = PositionLoop(gain, dsc=True, increments_per_revolution=turn, reference_rpm=RATED_RPM)
        self.path: Callable[[int], float] | None = None
        run.plc.before_frame.append(self._control)

    def _control(self, now: int) -> None:
        actuals = self.of.plc.endpoint.actuals[0]
        if self.path is not None and actuals is not None:
            self.values.update(self.loop.step(self.path(now), actuals))

    def follow_path(self) -> None:
        start, begin, period = self.shown("G1_XIST1"), self.of.loop.now(), self.period()
        moves, way = self.chance.randrange(1, 8), self.chance.uniform(-0.3, 0.3) * period * RATED_RPM / 60
        way *= INCREMENTS_PER_REVOLUTION

        def path(now: int) -> float:
            phase = min((now - begin) / SECOND / period, moves / 2)
            return start + way * (1 - math.cos(2 * math.pi * phase)) / 2

        self.path = path
        near = 4 + _SLOWEST / self.loop.gain
        self.until(begin, moves * period / 2)
        self.ends("position", lambda: abs(self.loop.error) <= near, 4 * _END_NS)
        self.path = None
        self.follows(0.0)


class RawProgram(SpeedProgram):
    """Telegram 100: the drive's own words, with a mode of operation for each task."""

    def __init__(self, run: CalmRun) -> None:
        super().__init__(run)
        self.tasks = (self.to_and_fro, self.profile, self.stream, self.off_and_on, self.position, self.home)

    def start(self, mode: Mode) -> None:
        """Select a mode, and give the edge of a new setpoint or homing."""
        self.values["Modes of Operation"] = int(mode)
        self.ends(f"mode {mode}", lambda: self.shown("Modes of Operation Display") == mode)
        self.of.loop.sleep(self.of.late_ns)  # Statusword.12 is still that of the mode before
        self.set(self.words.on | _NO_REJECT)

    def position(self) -> None:
        for _ in range(self.chance.randrange(1, 6)):
            target, share = self.chance.randrange(-100_000, 100_000), self.chance.uniform(0.1, 1)
            seconds = abs(target - self.model.position) / INCREMENTS_PER_REVOLUTION / share / 50
            ramps = {"Profile Acceleration": 1000, "Profile Deceleration": 1000}
            self.values.update(ramps | {"Target Position": target, "Profile Velocity": max(1, int(6000 * share))})
            self.start(Mode.POSITION)
            self.wait_bits("acknowledge", "Statusword", _ACKNOWLEDGED)
            self.set(self.words.on)
            self.wait_bits("end of the acknowledge", "Statusword", _ACKNOWLEDGED, gone=True)
            self.ends(f"target {target}", lambda: self.at(target), _END_NS + int(2 * seconds * SECOND))  # noqa: B023

    def at(self, target: float) -> bool:
        """Whether the axis has arrived: Statusword.10, the shaft, and the position that the PLC sees."""
        shown = abs(self.shown("Position Actual Value") - target) <= 1
        return bool(self.shown("Statusword") & _REACHED) and shown and self.stands()

    def home(self) -> None:
        self.start(Mode.HOMING)
        self.ends("homing", lambda: self.model.position == 0)
        self.wait_bits("end of homing", "Statusword", _ACKNOWLEDGED | _REACHED)
        self.set(self.words.on)


class TaskProgram(AxisProgram):
    """Traversing tasks of telegrams 7, 9, 110, 111 and 112. Positions are revolutions."""

    def __init__(self, run: CalmRun) -> None:
        super().__init__(run)
        number, values = self.words.telegram.number, self.values
        self.positioner = number in POSITIONER_TELEGRAM_NUMBERS
        self.suffix = "_F" if number in FLOAT_TELEGRAM_NUMBERS else ""
        self.mdi = "OVERRIDE" in values or not self.positioner
        self.selection = "POS_STW1" if "POS_STW1" in values else "SATZANW"
        self.tasks = (self.homing, self.off_and_on)
        if self.positioner:
            self.tasks += (self.jog, self.block, self.rejected)
        if self.mdi:
            self.tasks += (self.to_and_fro, self.relative, self.targets, self.stopped_on_the_way, self.rejected)
        if self.selection == "POS_STW1":
            self.tasks += (self.setting_up, self.update)
        if "OVERRIDE" in values:
            values["OVERRIDE"] = 0x4000
        if not self.positioner:
            values["SATZANW"] = 0x8000

    # -- units and values -------------------------------------------------------------------------------------------------

    def units(self, revolutions: float) -> float:
        """A position in the telegram's unit."""
        if not self.positioner:
            return revolutions * INCREMENTS_PER_REVOLUTION / _RANGE * N4_100_PERCENT
        return revolutions * (_UNITS_PER_REVOLUTION if self.suffix else _LU_PER_REVOLUTION)

    def order(self, target: float, share: float, *, absolute: bool = True, more: int = 0) -> None:
        """The data of an MDI task. ``more``: further bits of POS_STW1."""
        percent = self.chance.uniform(20, 100)
        full = N4_100_PERCENT if not self.positioner else _FULL_VELOCITY
        data = {"MDI_TARPOS": self.units(target), "MDI_VELOCITY": max(1.0, share * full)}
        ramps = {"MDI_ACC": percent, "MDI_DEC": percent}
        if self.suffix:
            self.values.update({f"{name}_F": float_pattern(value) for name, value in (data | ramps).items()})
        else:
            n2 = {name: value * 0x4000 / 100 for name, value in ramps.items()}
            self.values.update({name: round(value) for name, value in (data | n2).items()})
        if "MDI_MOD" in self.values:
            self.values |= {"SATZANW": 0x8000, "MDI_MOD": int(absolute)}
        else:
            self.values["POS_STW1"] = 0x8000 | absolute << 8 | more

    def begin(self) -> None:
        if self.mdi:
            self.start(self.chance.uniform(-20, 20), self.chance.uniform(0.05, 1))
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
            self.wait_bits("end of the acknowledge", "ZSW1", _ACKNOWLEDGED, gone=True)
        self.set(self.words.on | _TASK)
        if fresh:
            self.wait_bits("acknowledge", "ZSW1", _ACKNOWLEDGED)
            self.set(self.words.on)

    def arrives(self, target: float, share: float) -> None:
        """The task ends at its target: ZSW1.10, the shaft, and the position that the PLC sees."""
        seconds = abs(self.where - target) / share / (RATED_RPM / 60)
        self.ends(f"target {target:.3f} of {self.task}", lambda: self.at(target), _END_NS + int(2 * seconds * SECOND))

    @property
    def where(self) -> float:
        """Position of the shaft."""
        return self.model.position / INCREMENTS_PER_REVOLUTION

    def at(self, target: float) -> bool:
        """Whether the axis has arrived."""
        right = abs(self.where - target) <= _WINDOW and self.stands() and bool(self.shown("ZSW1") & _REACHED)
        return right and self.shows(target)

    def shows(self, target: float) -> bool:
        """Whether the PLC sees this position."""
        if not self.mdi:
            return True
        raw = self.shown(f"XIST{self.suffix or '_A'}")
        return abs((float_of(raw) if self.suffix else raw) - self.units(target)) <= self.units(_WINDOW)

    # -- tasks -----------------------------------------------------------------------------------------------------------

    def to_and_fro(self) -> None:
        period, ends = self.period(), [self.chance.uniform(-20, 20), 0.0]
        ends[1] = ends[0] + self.chance.uniform(0.1, 4) * self.chance.choice((-1, 1))
        share = self.chance.choice((1.0, self.chance.uniform(0.1, 1)))
        for n in range(self.chance.randrange(6, 24)):
            begin = self.of.loop.now()
            self.start(ends[n % 2], share)
            self.arrives(ends[n % 2], share)
            self.until(begin, period / 2)

    def relative(self) -> None:
        for _ in range(self.chance.randrange(1, 6)):
            way, share = math.copysign(self.chance.uniform(0.1, 5), -self.where), abs(self.speed())
            target = self.where + way
            self.start(way, share, absolute=False)
            self.arrives(target, share)

    def targets(self) -> None:
        """Each task replaces the one before on its way."""
        for _ in range(self.chance.randrange(2, 12)):
            target, share = self.chance.uniform(-20, 20), self.chance.uniform(0.1, 1)
            self.start(target, share)
            self.sleep(self.chance.uniform(0, 0.5))
        self.arrives(target, share)

    def stopped_on_the_way(self) -> None:
        target, share = self.chance.uniform(-20, 20), self.chance.uniform(0.05, 1)
        self.start(target, share)
        self.sleep(self.chance.uniform(0, 0.5))
        self.set(self.words.word & ~_NO_STOP)
        self.sleep(self.chance.uniform(0.2, 1))
        self.ends("standstill", self.stands)
        self.set(self.words.word | _NO_STOP)
        self.arrives(target, share)

    def rejected(self) -> None:
        self.begin()
        self.sleep(self.chance.uniform(0, 0.5))
        self.reject()

    def reject(self) -> None:
        """STW1.4 = 0 stops the axis."""
        self.set(self.words.on & ~_NO_REJECT)
        self.sleep(self.chance.uniform(0.2, 1))
        self.ends("standstill", self.stands)
        self.set(self.words.on)

    def homing(self) -> None:
        if not self.positioner:
            self.values["SATZANW"] = 0x8000 | 35
        self.set(self.words.on)
        self.set(self.words.on | _HOMING)
        self.ends("homing", lambda: bool(self.shown("ZSW1") & _HOMED) and self.where == 0 and self.shows(0))
        self.set(self.words.on)

    def jog(self) -> None:
        self.set(self.words.on)
        self.set(self.words.on | self.chance.choice((_JOG_1, _JOG_2)))
        self.ends("start of the jog", lambda: not self.stands())
        self.sleep(self.chance.uniform(0, 2))
        self.set(self.words.on)
        self.ends("standstill", self.stands)

    def block(self) -> None:
        number = self.chance.choice(tuple(_BLOCKS))
        self.values[self.selection] = number
        self.edge()
        self.arrives(_BLOCKS[number], _BLOCK_SHARE)

    def setting_up(self) -> None:
        self.start(0.0, self.chance.uniform(0.02, 0.4), absolute=False, more=0x4200 if self.where < 0 else 0x4400)
        self.ends("start of setting up", lambda: not self.stands())
        self.sleep(self.chance.uniform(0, 1))
        self.reject()

    def update(self) -> None:
        """A stream of targets without edges."""
        target, share = self.chance.uniform(-20, 20), self.chance.uniform(0.1, 1)
        self.set(self.words.on)
        self.order(target, share, more=0x1000)
        self.set(self.words.on | _TASK)
        for _ in range(self.chance.randrange(2, 30)):
            self.of.loop.sleep(self.chance.choice((1, 2, 5, 40)) * self.of.cycle_ns)
            target += self.chance.uniform(-1, 1)
            self.order(target, share, more=0x1000)
        self.arrives(target, share)


class EncoderProgram(Program):
    """An encoder that turns and stops, with presets."""

    def __init__(self, run: CalmRun) -> None:
        super().__init__(run)
        assert run.encoder is not None
        self.model = run.encoder.model
        self.values.update({"STW2_ENC": 0x0400, "G1_STW": _ABSOLUTE})
        self.tasks = (self.preset, self.preset, self.turn, self.park)

    def power_on(self) -> None:
        self.ends("absolute value", lambda: bool(self.shown("G1_ZSW") & _ABSOLUTE), _ONLINE_NS)

    def preset(self) -> None:
        """An absolute or relative preset at standstill."""
        self.model.set_motion(still(self.model.channels[1].mechanical))
        self.sleep(0.2)
        before, counted = self.shown("G1_XIST2"), self.shown("G1_XIST1")
        relative = self.chance.random() < 0.5
        value = self.chance.randrange(1, 1_000_000)
        channel = WorldChannel(self.of.world, self.of.acyclic, "192.168.0.20")
        activity = uuid.UUID(int=self.chance.getrandbits(128))
        with ParameterClient(self.of.acyclic, 1, channel=channel, activity=activity, timeout_s=3) as client:
            (answer,) = client.request([ParameterAddress(_PRESET_PNU)], [Values(DataType.INTEGER32, (value,))])
        if answer.failed:
            raise ViolationError(f"P{_PRESET_PNU} is rejected: {answer.text}")
        self.values["G1_STW"] = _ABSOLUTE | _PRESET | relative << 11
        self.wait_bits("preset", "G1_ZSW", _PRESET)
        wanted = (before + value if relative else value) % self.model.chain.total_range
        self.ends(f"position {wanted}", lambda: self.shown("G1_XIST2") == wanted)
        if self.shown("G1_XIST1") != counted:
            raise ViolationError(f"the preset moves G1_XIST1 from {counted} to {self.shown('G1_XIST1')}")
        self.values["G1_STW"] = _ABSOLUTE
        self.wait_bits("end of the preset", "G1_ZSW", _PRESET, gone=True)
        self.wait_bits("absolute value", "G1_ZSW", _ABSOLUTE)

    def turn(self) -> None:
        """A constant speed is seen as NIST_B; then the encoder swings."""
        share, start = self.speed(), self.model.channels[1].mechanical
        self.model.set_motion(constant_speed(share * RATED_RPM / 60, start))
        asked = share * N4_100_PERCENT
        self.ends("speed", lambda: abs(self.shown("NIST_B") - asked) <= 0.02 * N4_100_PERCENT)
        self.sleep(self.chance.uniform(0, 3))
        self.model.set_motion(sine(self.chance.uniform(0, 3), self.period(), self.model.channels[1].mechanical))
        self.sleep(self.chance.uniform(0, 5))

    def park(self) -> None:
        self.values["G1_STW"] = _PARK
        self.wait_bits("parked", "G1_ZSW", _PARK)
        self.values["G1_STW"] = _ABSOLUTE
        self.wait_bits("absolute value", "G1_ZSW", _ABSOLUTE)


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
