"""Torque reduction and the message words of the drive telegrams: MOMRED, MELDW and MELD_NAMUR from and to values of CiA 402.

Source: drive manuals (one source for the bits of MELDW, none for the scaling of MOMRED: docs/telegrams.md "Sources").
"""

from __future__ import annotations

from typing import Final

from pdgw.profidrive.datatypes import N2_100_PERCENT
from pdgw.profidrive.signals import signal

_MELDW = {bit.name: bit.mask for bit in signal("MELDW").bits}
SPEED_WITHIN_TOLERANCE: Final = _MELDW["SPEED_WITHIN_TOLERANCE"]
_AT_SPEED = SPEED_WITHIN_TOLERANCE | _MELDW["RAMP_COMPLETED"]


def reduced_torque(base: int, momred: int) -> int:
    """The torque limit 6072h under a torque reduction (N2, 4000h = no torque at all); a negative one reduces nothing."""
    left = N2_100_PERCENT - max(0, min(momred, N2_100_PERCENT))
    return base * left // N2_100_PERCENT


_NAMUR = signal("MELD_NAMUR")
_OTHER = _NAMUR.bit("OTHER").mask
_NAMUR_OF_CODE: Final = {
    0x2330: "GROUND_FAULT",
    0x3210: "DC_LINK_OVERVOLTAGE",
    0x3220: "LINE",
    0x21: "POWER_UNIT",
    0x22: "POWER_UNIT",
    0x23: "POWER_UNIT",
    0x31: "LINE",
    0x33: "POWER_UNIT",
    0x41: "OVERTEMPERATURE",
    0x42: "OVERTEMPERATURE",
    0x43: "MOTOR_OVERLOAD",
    0x50: "CONVERTER",
    0x51: "CONVERTER",
    0x52: "CONVERTER",
    0x53: "CONVERTER",
    0x54: "POWER_UNIT",
    0x55: "CONVERTER",
    0x60: "CONVERTER",
    0x61: "CONVERTER",
    0x62: "CONVERTER",
    0x63: "CONVERTER",
    0x81: "COMMUNICATION",
    0x82: "COMMUNICATION",
}
"""Bit of MELD_NAMUR by error code (CiA 402) without its last digit, else by its class."""


def namur_word(code: int) -> int:
    """MELD_NAMUR of an error code (603Fh, EMCY); 0 for none."""
    if not code:
        return 0
    name = _NAMUR_OF_CODE.get(code & 0xFFF0) or _NAMUR_OF_CODE.get(code >> 8)
    return _OTHER if name is None else _NAMUR.bit(name).mask


TOLERANCE_PERCENT: Final = 1
_SPEED_3_PERCENT: Final = 5
_SPEED_2_PERCENT: Final = 30
"""Thresholds of the speed, of its reference."""
_TORQUE_THRESHOLD: Final = 900
"""In 1/1000 of the rated torque, as 6077h is."""


class MessageWord:
    """MELDW of one axis. ``reference``: 100 % speed in the drive's velocity units.

    ``torque``: the drive has 6078h; without it the bit that is made from it is 0.
    """

    def __init__(self, reference: int, *, torque: bool = True) -> None:
        self._tolerance = reference * TOLERANCE_PERCENT // 100
        self._torque = _TORQUE_THRESHOLD if torque else 0  # no value is below 0
        self._speed_3 = reference * _SPEED_3_PERCENT // 100
        self._speed_2 = reference * _SPEED_2_PERCENT // 100

    @staticmethod
    def states(*, enabled: bool, ready: bool) -> int:
        """The bits of the state. ``enabled``: operation enabled or quick stop active; ``ready``: no fault and not switch on
        disabled."""
        word = _MELDW["CONTROLLER_ENABLED"] | _MELDW["PULSES_ENABLED"] if enabled else 0
        return word | _MELDW["DRIVE_READY"] if ready else word

    def word(
        self,
        velocity: int,
        demand: int,
        torque: int,
        states: int,
        *,
        target_reached: bool,
        motor_hot: bool = False,
        stage_hot: bool = False,
    ) -> int:
        """The word of this cycle.

        ``velocity`` 606Ch, ``demand`` 606Bh, ``torque`` 6077h; ``states``: what ``states`` says; ``target_reached``:
        Statusword.10; ``motor_hot``, ``stage_hot``: that fault is present.
        """
        word = states
        if not motor_hot:
            word |= _MELDW["NO_MOTOR_OVERTEMPERATURE"]
        if not stage_hot:
            word |= _MELDW["NO_POWER_STAGE_OVERTEMPERATURE"]
        tolerance = self._tolerance
        if -tolerance <= velocity - demand <= tolerance:
            word |= _AT_SPEED if target_reached else SPEED_WITHIN_TOLERANCE
        if -self._torque < torque < self._torque:
            word |= _MELDW["TORQUE_BELOW_THRESHOLD"]
        if velocity < 0:
            velocity = -velocity
        if velocity <= self._speed_2:
            word |= _MELDW["SPEED_BELOW_THRESHOLD_2"]
        return word | _MELDW["SPEED_BELOW_THRESHOLD_3"] if velocity < self._speed_3 else word
