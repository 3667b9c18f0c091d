"""The program of a PLC that follows remedies literally, and what the shaft of the axis does meanwhile."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

from pdgw.dsp402.states import State, state_of
from pdgw.gateway.axis.demand_report import SpeedDemand
from pdgw.gateway.axis.executors.positions.motion import MotionExecutor
from pdgw.gateway.axis.executors.speed import SpeedExecutor
from pdgw.gateway.axis.telegrams import ENCODER_TELEGRAM_NUMBERS
from pdgw.gateway.base.steps import Acknowledge, Bits, Edge, Give, Hindrance, Remedy, Wait
from pdgw.gateway.motion.states import State as Function
from pdgw.gateway.objects.axis import Axis
from pdgw.gateway.objects.enable_status import ChainLink
from pdgw.profidrive.datatypes import float_pattern
from tests.support.gateways.daemon import OFF, POSITIONER, Plc, drive_of, encoder_of

_FRAMES: Final = 10
"""Frames of 20 ms in which a drive follows a bit."""
_WAIT: Final = 150
"""Frames of a wait: as long as a ramp."""
_HALF: Final = 0x2000_0000
_SPEED: Final = {"STW1": 0x047F, "NSOLL_A": 0x0800, "NSOLL_B": 0x0800_0000}
_MDI: Final = {"STW1": 0x043F, "OVERRIDE": 0x4000, "MDI_VELOCITY": 12_000, "MDI_ACC": 0x4000, "MDI_DEC": 0x4000}
_LENGTH: Final = {
    "MDI_TARPOS_F": float_pattern(5.0),
    "MDI_VELOCITY_F": float_pattern(50.0),
    "MDI_ACC_F": float_pattern(100.0),
    "MDI_DEC_F": float_pattern(100.0),
}
_WORDS: Final[Mapping[int, Mapping[str, int]]] = {
    7: {"STW1": 0x043F, "SATZANW": 1},
    9: {
        "STW1": 0x043F,
        "SATZANW": 0x8023,
        "MDI_TARPOS": 1 << 26,
        "MDI_VELOCITY": _HALF,
        "MDI_ACC": 0x2000,
        "MDI_DEC": 0x2000,
        "MDI_MOD": 1,
    },
    100: {"Controlword": 0x0F},
    110: {**_MDI, "SATZANW": 0x8000, "MDI_MOD": 1, "MDI_TARPOS": 20_000},
    111: {**_MDI, "POS_STW1": 0x8100, "MDI_TARPOS": 20_000},
    112: {**_MDI, **_LENGTH, "POS_STW1": 0x8100},
}
"""What a program sends that may start a task: without its edge."""
_BLOCK: Final = "[[axis.block]]\nnumber = 1\nposition = 20_000\nvelocity = 12_000\n"
_DSC: Final = 'dsc = "speed"\nfollowing_window = 10_000\n'
_SIGNALS: Final = {
    "MDI_VELOCITY": ("MDI_VELOCITY", "MDI_VELOCITY_F", "OVERRIDE"),
    "MDI_ACC": ("MDI_ACC", "MDI_DEC", "MDI_ACC_F", "MDI_DEC_F"),
    "MDI_TARPOS": ("MDI_TARPOS", "MDI_TARPOS_F"),
    "OVERRIDE": ("OVERRIDE",),
    "XERR": ("XERR",),
}
"""Signals by what a step gives."""
_LEVELS: Final = {
    "direction": {"POSITIVE_DIRECTION": 1, "NEGATIVE_DIRECTION": 0},
    "ABSOLUTE": {"ABSOLUTE": 1},
    "BLOCK": {"BLOCK": 1},
    "HOMING_METHOD": {"HOMING_METHOD": 35},
}
"""Fields of control words by what a step gives."""
_FUNCTIONS: Final = {
    Function.MDI: 1 << 6,
    Function.SETTING_UP: 1 << 6,
    Function.BLOCK: 1 << 6,
    Function.JOG: 3 << 8,
    Function.JOG_INCREMENTAL: 3 << 8,
    Function.HOMING: 1 << 11,
}
"""Bits of STW1 that ask for a function."""
_JOGS, _SETPOINT = 3 << 8, 7 << 4


def table(number: int) -> str:
    """An axis or encoder with this telegram, and everything that it needs."""
    if number in ENCODER_TELEGRAM_NUMBERS:
        return f"[[encoder]]\ndo_id = 1\nnode_id = 20\ntelegram = {number}\nsimulate = true\n"
    jogs = "jog_speeds_rpm = [-150, 150]\n" if number in (1, 2, 3, 4, 20, 102, 103) else ""
    dsc = _DSC if number in (5, 6, 105, 106) else ""
    positioner = POSITIONER + _BLOCK if number in (7, 110, 111, 112) else ""
    return f"[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = {number}\nsimulate = true\n{jogs}{dsc}{positioner}"


class Follower:
    """The first drive object and its program. ``asked``: bits of STW1 that the program has set since it was in operation."""

    def __init__(self, plc: Plc) -> None:
        self.plc, self.item = plc, plc.daemon.objects[0]
        self.telegram = self.item.telegram
        names = self.telegram.setpoints.names
        self.first = names[0]
        words = _WORDS.get(self.telegram.number, _SPEED)
        self.right = {name: value for name, value in words.items() if name in names}
        self.asked = 0
        self.by_jog = False
        """A jog with a speed is asked for, and not the setpoint."""

    @property
    def broken(self) -> ChainLink | None:
        """The first broken link."""
        return self.item.enable_status.broken

    @property
    def words(self) -> dict[str, int]:
        """What the program sends."""
        return self.plc.endpoint.setpoints[0]

    def exchange(self, frames: int, **values: int) -> None:
        """Send words for a number of frames; each time, the shaft moves only as asked."""
        if values:
            self.plc.endpoint.set(0, values)
        self.asked |= self.words.get("STW1", 0)
        for _ in range(frames):
            self.plc.exchange()
            self._judge()

    def _judge(self) -> None:
        axis = self.item
        if not isinstance(axis, Axis):
            return
        machine, executor = axis.machine, axis.machine.executor
        if isinstance(executor, MotionExecutor):
            function = executor.positioner.state
            assert function not in _FUNCTIONS or _FUNCTIONS[function] & self.asked, f"{function.value}: not asked for"
        elif isinstance(executor, SpeedExecutor) and self.by_jog and isinstance(machine.demand, SpeedDemand):
            follows = machine.demand.speed_wish.name == "FOLLOW" and machine.interlock.operates
            assert not follows or not self.words.get(self.telegram.setpoints.names[1]), "turns by the setpoint"

    def fail(self) -> None:
        """The device has a fault for a moment."""
        daemon = self.plc.daemon
        if isinstance(self.item, Axis):
            drive_of(daemon).inject(7)
            self.exchange(2 * _FRAMES)
            drive_of(daemon).clear()
        else:
            encoder_of(daemon).inject("position-error")
            self.exchange(2 * _FRAMES)
            encoder_of(daemon).clear()

    def begin(self) -> None:
        """In operation, with nothing that is refused."""
        self.exchange(_FRAMES, **dict.fromkeys(self.telegram.setpoints.names, 0))
        if not isinstance(self.item, Axis):
            for sensor, word in ((0, 0), (0x8000, 0), (0, 0x80), (0, 0)):
                self.exchange(5 * _FRAMES, STW2_ENC=0x400 | word, G1_STW=sensor)
            self.plc.until(lambda: self.broken is None, "operation")
            return
        off = 0x06 if self.first == "Controlword" else OFF & ~_SETPOINT
        self.exchange(_FRAMES, **self.right | {self.first: off})
        self.exchange(_FRAMES, **{self.first: off | 0x80})
        self.exchange(_FRAMES, **{self.first: off})
        self.asked, self.by_jog = 0, False
        self.plc.until(lambda: not self._stays_off(), "ready")
        self.exchange(2 * _FRAMES, **self.right)
        self.plc.until(lambda: self.broken is None, "operation")

    def _stays_off(self) -> bool:
        axis = self.item
        return isinstance(axis, Axis) and state_of(axis.drive.feedback.statusword) is not State.READY_TO_SWITCH_ON

    def follow(self, remedy: Remedy) -> list[str]:
        """Do each step; returns those of a person."""
        word = self.words.get("STW1", 0)
        self.by_jog |= bool(word & _JOGS and not word & _SETPOINT)
        left: list[str] = []
        for step in remedy:
            match step:
                case str():
                    left.append(step)
                case Wait():
                    self.exchange(_WAIT)
                case Bits(bits, level):
                    self._set(bits, level)
                case Edge(bits, needs):
                    self._rise(bits, needs)
                case Acknowledge():
                    self._acknowledge(step)
                case Give(what):
                    self._give(what)
        self.exchange(_WAIT)
        return left

    def _set(self, bits: tuple[str, ...], level: int) -> None:
        for bit in bits:
            name, _, place = bit.split(" ")[0].partition(".")
            if name not in self.words:
                name = {"POS_STW2": "POS_STW", "STW1": "Controlword"}[name]
            mask = 1 << int(place)
            self.plc.endpoint.set(0, {name: self.words[name] & ~mask | mask * level})
        self.exchange(_FRAMES)

    def _rise(self, bits: tuple[str, ...], needs: tuple[str, ...]) -> None:
        self._set(bits, 0)
        if bits == ("STW1.0",):
            self.exchange(_WAIT)
        self._set(needs, 1)
        self._set(bits[:1], 1)

    def _acknowledge(self, step: Acknowledge) -> None:
        match step.hindrance:
            case Hindrance.PENDING:
                return
            case Hindrance.UNFINISHED:
                self._set((step.bit,), 0)
                return
            case Hindrance.NO_CONTROL | Hindrance.UNHEARD:
                self._set((step.control,), 1)
        if step.hindrance not in (Hindrance.NONE, Hindrance.NO_CONTROL):
            self._set((step.bit,), 0)
        self._set((step.bit,), 1)

    def _give(self, what: str) -> None:
        signals = {name: self.right.get(name, 0) for name in _SIGNALS.get(what, ()) if name in self.words}
        if "MDI_TARPOS" in signals:
            signals["MDI_TARPOS"] = 100  # inside narrow software limits, too
        self.plc.endpoint.set(0, signals)
        for name, value in self._fields(_LEVELS.get(what, {})):
            self.plc.endpoint.set(0, {name: value})
        self.exchange(_FRAMES)
        if what == "active function":
            self._set(("STW1.8", "STW1.9"), 0)
            if {"POS_STW", "POS_STW2"} & set(self.words):
                self._set(("POS_STW2.0",), 0)
            self.exchange(_WAIT)
            self._set(("STW1.4",), 0)
            self.exchange(_WAIT)
            self._set(("STW1.4",), 1)
        elif what == "task":
            self._rise(("STW1.6",), ())
        elif what == "G1_STW":
            self.exchange(_FRAMES, G1_STW=0)
        elif what == "other direction":
            self._turn_round()

    def _turn_round(self) -> None:
        """A setpoint, a jog or a task in the other direction, and then none."""
        jogs = self.words["STW1"] & _JOGS
        if "NSOLL_A" in self.words:
            self.exchange(_WAIT, NSOLL_A=-self.words["NSOLL_A"])
            self.exchange(_FRAMES, NSOLL_A=0)
        elif jogs:
            self._set(("STW1.8", "STW1.9"), 0)
            self._set(("STW1.9",) if jogs == 1 << 8 else ("STW1.8",), 1)
            self.exchange(_WAIT)
            self._set(("STW1.8", "STW1.9"), 0)
        else:
            values = {**self.right, "MDI_TARPOS": -self.words["MDI_TARPOS"]}
            self.exchange(_FRAMES, **values)
            self._rise(("STW1.6",), ())

    def _fields(self, levels: Mapping[str, int]) -> Iterator[tuple[str, int]]:
        for item in self.telegram.setpoints.signals:
            for field in item.fields(positioning=True):
                if field.name in levels:
                    yield item.name, self.words[item.name] & ~field.mask | levels[field.name] << field.position
