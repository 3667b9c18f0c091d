"""What the PLC of a soak asks of an axis: mostly what a PLC program would, now and then anything."""

from __future__ import annotations

from collections.abc import Callable
from random import Random

from pdgw.dsp402.modes import Mode
from pdgw.profidrive.telegrams import Telegram

OFF_BIT = 0x0001
ACKNOWLEDGE = 0x0080
TRANSPARENT = 100
_POSITIONING = 9
_ENABLED = 0x000F
_TASK, _HOMING = 0x0040, 0x0800
_SPEEDS = {"NSOLL_A": 1 << 14, "NSOLL_B": 1 << 30, "Target Velocity": 6000}
"""Set-points of speed and their 100 %."""
_MODES = (Mode.VELOCITY, Mode.POSITION, Mode.TORQUE, Mode.HOMING)


class Words:
    """The set-points of one axis. ``draw`` changes them as chance has it."""

    def __init__(self, telegram: Telegram, chance: Random) -> None:
        self.telegram = telegram
        self.name = telegram.setpoints.names[0]
        """STW1 or the Controlword: bit 0 says ON in both."""
        self.values: dict[str, int] = dict.fromkeys(telegram.setpoints.names, 0)
        self.chance = chance
        transparent = telegram.number == TRANSPARENT
        self.off = 0x0006 if transparent else 0x043E if telegram.number == _POSITIONING else 0x047E
        self.on = self.off | _ENABLED
        self.commands = 0
        """Edges and bits that may start or continue a task, so far."""
        self._later: list[int] = []
        """Words that follow, one in each draw."""

    @property
    def word(self) -> int:
        """STW1 or the Controlword."""
        return self.values[self.name]

    def set_word(self, word: int) -> None:
        """Another word; what may start a task is counted."""
        risen = word & ~self.word
        self.commands += bool(risen & (_TASK | _HOMING | 0x0010 | 0x0020 | _ENABLED))
        self.values[self.name] = word

    def draw(self) -> None:
        """Something else is asked from now on."""
        chance = self.chance
        if self._later:
            self.set_word(self._later.pop(0))
            return
        choice: Callable[[], None] = chance.choices(
            (self._enable, self._off, self._on, self._setpoint, self._special, self._drop, self._edge, self._anything),
            (6, 3, 3, 8, 6, 3, 3, 1),
        )[0]
        choice()

    def _enable(self) -> None:
        self.set_word(self.off)
        self._later = [self.off | ACKNOWLEDGE, self.off, self.off | 0x07, self.on]

    def _off(self) -> None:
        self.set_word(self.word & ~OFF_BIT)

    def _on(self) -> None:
        self.set_word(self.on)

    def _drop(self) -> None:
        """Coast stop, quick stop, disable operation, or a bit of the ramp generator, and back."""
        word = self.word
        self.set_word(word & ~(1 << self.chance.randrange(1, 7)))
        if self.chance.random() < 0.7:
            self._later = [word]

    def _edge(self) -> None:
        word = self.word
        self.set_word(word ^ self.chance.choice((ACKNOWLEDGE, 0x0400, OFF_BIT)))
        self._later = [word]

    def _anything(self) -> None:
        self.set_word(self.chance.randrange(0x10000))

    def _setpoint(self) -> None:
        """Another speed."""
        chance = self.chance
        for name, full in _SPEEDS.items():
            if name in self.values:
                self.values[name] = chance.choice((0, full, -full, chance.randrange(-full, full)))

    def _special(self) -> None:
        """What only some telegrams have."""
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
        else:
            self._setpoint()
