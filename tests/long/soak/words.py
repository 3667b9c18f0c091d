"""The PLC's commands for an axis in the soak: mostly those of a PLC program, sometimes random ones."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from random import Random
from typing import Final

from pdgw.base.durations import MS
from pdgw.dsp402.modes import Mode
from pdgw.gateway.axis.telegrams import TASK_TELEGRAM_NUMBERS
from pdgw.profidrive.telegrams import Telegram
from tests.long.soak.plan import TRANSPARENT

OFF_BIT: Final = 0x0001
ACKNOWLEDGE: Final = 0x0080
CONTROL: Final = 0x0400
"""STW1.10: control by PLC."""
_POSITIONING = 9
_ENABLED: Final = 0x000F
_TASK, _HOMING = 0x0040, 0x0800
SPEEDS: Final = {"NSOLL_A": 1 << 14, "NSOLL_B": 1 << 30, "Target Velocity": 6000}
"""Speed setpoints and their 100 %."""
_ACTUALS: Final = {"NIST_A": 1 << 14, "NIST_B": 1 << 30, "Velocity Actual Value": 6000}
_MODES = (Mode.VELOCITY, Mode.POSITION, Mode.TORQUE, Mode.HOMING)
_LONGEST_WORD_NS = 250 * MS
_LONGEST_REST_NS = 1500 * MS
_FULL = 0x4000
_VALUES: Final[Mapping[str, Callable[[Random], int]]] = {
    "SATZANW": lambda chance: chance.choice((0x8000, 0x8000, 1, 2)),
    "POS_STW1": lambda chance: chance.choice((0x8100, 0x8000, 0xC200, 0xC400, 1, 2)),
    "OVERRIDE": lambda chance: chance.choice((_FULL, _FULL, 0, chance.randrange(2 * _FULL))),
    "MDI_TARPOS": lambda chance: chance.randrange(-100_000, 100_000),
    "MDI_VELOCITY": lambda chance: chance.randrange(100, 30_000),
    "MDI_ACC": lambda chance: _FULL,
    "MDI_DEC": lambda chance: _FULL,
    "MDI_MOD": lambda chance: chance.randrange(2),
    "MOMRED": lambda chance: chance.choice((0, 0, 0x2000)),
    "XERR": lambda chance: chance.choice((0, 0, chance.randrange(-5000, 5000))),
    "KPC": lambda chance: chance.choice((0, 0, 1000, 20_000)),
}
"""Random values of the other setpoints, by name."""


def is_off(word: int, *, raw: bool) -> bool:
    """Whether a control word releases the lock after a loss: OFF1 alone, with control by the PLC. ``raw``: a Controlword."""
    return word & 0x07 == 0x06 and (raw or bool(word & CONTROL))


def is_on(word: int, *, raw: bool) -> bool:
    """Whether a control word commands operation."""
    return word & _ENABLED == _ENABLED and (raw or bool(word & CONTROL))


def asked_share(values: Mapping[str, int]) -> float | None:
    """The commanded speed as a share of 100 %. None where other values set the speed."""
    name = next((name for name in SPEEDS if name in values), None)
    if name is None or values.get("KPC") or values.get("MOMRED"):
        return None
    if values.get("Modes of Operation", Mode.VELOCITY) != Mode.VELOCITY:
        return None
    return values[name] / SPEEDS[name]


def shown_share(actuals: Mapping[str, int] | None) -> float | None:
    """The actual speed that the PLC sees, like ``asked_share``. None where the telegram has none."""
    if actuals is None:
        return math.nan
    name = next((name for name in _ACTUALS if name in actuals), None)
    return None if name is None else actuals[name] / _ACTUALS[name]


class Words:
    """The setpoints of one axis. ``draw`` changes them at random."""

    def __init__(self, telegram: Telegram, chance: Random, cycle_ns: int) -> None:
        self.telegram = telegram
        self.name = telegram.setpoints.names[0]
        """STW1 or the Controlword; bit 0 is ON in both."""
        self.values: dict[str, int] = dict.fromkeys(telegram.setpoints.names, 0)
        self.chance = chance
        self._cycle_ns = cycle_ns
        self.raw = telegram.number == TRANSPARENT
        """The telegram carries the Controlword itself."""
        self.off = 0x0006 if self.raw else 0x043E if telegram.number in TASK_TELEGRAM_NUMBERS else 0x047E
        self.on = self.off | _ENABLED
        self.commands = 0
        """Number of edges and bits until now that may start or continue a task."""
        self._later: list[int] = []
        """Following words, one for each draw."""

    @property
    def word(self) -> int:
        """STW1 or the Controlword."""
        return self.values[self.name]

    def set_word(self, word: int) -> None:
        """Set another word and count it if it may start a task."""
        risen = word & ~self.word
        self.commands += bool(risen & (_TASK | _HOMING | 0x0010 | 0x0020 | _ENABLED))
        self.values[self.name] = word

    def word_duration_ns(self) -> int:
        """How long the present word is sent: one frame to 250 ms, or long enough for a ramp."""
        chance = self.chance
        kind = chance.random()
        if kind < 0.25:
            return chance.randrange(1, 5) * self._cycle_ns
        shortest = math.log(self._cycle_ns)
        longest = _LONGEST_WORD_NS if kind < 0.65 else _LONGEST_REST_NS
        return int(math.exp(chance.uniform(shortest, math.log(longest))))

    def draw(self) -> None:
        """Change the command."""
        chance = self.chance
        if self._later:
            self.set_word(self._later.pop(0))
            return
        choice: Callable[[], None] = chance.choices(
            (
                *(self._enable, self._off, self._on, self._acknowledge),
                *(self._setpoint, self._special, self._drop, self._edge, self._anything),
            ),
            (6, 3, 3, 2, 8, 6, 3, 3, 1),
        )[0]
        choice()

    def _enable(self) -> None:
        self.set_word(self.off)
        self._later = [self.off | ACKNOWLEDGE, self.off, self.off | 0x07, self.on]

    def _off(self) -> None:
        self.set_word(self.word & ~OFF_BIT)

    def _on(self) -> None:
        self.set_word(self.on)

    def _acknowledge(self) -> None:
        """Acknowledge a fault while ON is active."""
        self.set_word(self.on)
        self._later = [self.on | ACKNOWLEDGE, self.on]

    def _drop(self) -> None:
        """Coast stop, quick stop, disable operation or a ramp generator bit, and back."""
        word = self.word
        self.set_word(word & ~(1 << self.chance.randrange(1, 7)))
        if self.chance.random() < 0.7:
            self._later = [word]

    def _edge(self) -> None:
        word = self.word
        self.set_word(word ^ self.chance.choice((ACKNOWLEDGE, CONTROL, OFF_BIT)))
        self._later = [word]

    def _anything(self) -> None:
        self.set_word(self.chance.randrange(0x10000))

    def _setpoint(self) -> None:
        """Set another speed."""
        chance = self.chance
        for name, full in SPEEDS.items():
            if name in self.values:
                self.values[name] = chance.choice((0, full, -full, chance.randrange(-full, full)))

    def set_speed(self, share: float) -> bool:
        """Set a share of the full speed, without a task or a position loop. False where the telegram has no speed."""
        name = next((name for name in SPEEDS if name in self.values), None)
        if name is None:
            return False
        self._later = []
        for other in ("XERR", "KPC", "MOMRED"):
            if other in self.values:
                self.values[other] = 0
        if self.raw:
            profile = {"Profile Velocity": 6000, "Profile Acceleration": 300, "Profile Deceleration": 300}
            self.values |= {"Modes of Operation": int(Mode.VELOCITY), **profile}
        self.values[name] = int(share * SPEEDS[name])
        return True

    def _special(self) -> None:
        """Use a function that only some telegrams have."""
        chance = self.chance
        if self.telegram.number == _POSITIONING:
            if chance.random() < 0.2:
                self.values["SATZANW"] = 35
                self._later = [self.on, self.on | _HOMING]
                self.set_word(self.on)
                return
            self.values |= {
                "SATZANW": 0x8000,
                "MDI_TARPOS": chance.randrange(-400_000, 400_000),
                "MDI_VELOCITY": 1 << chance.randrange(24, 31),
                "MDI_ACC": 1 << 14,
                "MDI_DEC": 1 << 14,
                "MDI_MOD": chance.randrange(2),
            }
            self._later = [self.on | _TASK, self.on]
            self.set_word(self.on)
        elif self.telegram.number == TRANSPARENT:
            self.values |= {
                "Modes of Operation": int(chance.choice(_MODES)),
                "Target Position": chance.randrange(-400_000, 400_000),
                "Profile Velocity": chance.randrange(1, 6000),
                "Profile Acceleration": chance.choice((100, 1000)),
                "Profile Deceleration": chance.choice((100, 1000)),
                "Target Torque": chance.randrange(-200, 200),
            }
            self._later = [self.on | 0x10, self.on]
            self.set_word(self.on)
        elif self.telegram.number in TASK_TELEGRAM_NUMBERS:
            self._draw_values()
            start = chance.choice((_TASK, _TASK, _TASK, 0x0100, 0x0200, _HOMING))
            self._later = [self.on | start, self.on]
            self.set_word(self.on)
        else:
            self._draw_values()
            self._setpoint()

    def _draw_values(self) -> None:
        self.values |= {name: draw(self.chance) for name, draw in _VALUES.items() if name in self.values}
