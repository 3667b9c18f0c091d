"""The option codes of CiA 402: how a drive stops, and what it does when its master is lost.

Source: CiA 402-2 (605Ah to 605Eh, 6007h); CiA DSP 402 V2.0, chapter 10, for 605Dh = 0, which later editions reserve. Not
simulated and refused: the voltage limit (4 and 8), the manufacturer's values.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from pdgw.dsp402.objects import (
    ABORT_OPTION,
    DISABLE_OPERATION_OPTION,
    FAULT_REACTION_OPTION,
    HALT_OPTION,
    QUICK_STOP_OPTION,
    SHUTDOWN_OPTION,
)
from pdgw.dsp402.states import Command, State


class Braking(enum.Enum):
    """What the motor does; the value is the text of the standard."""

    NONE = "drive function disabled, motor free"
    SLOW_DOWN = "slow down ramp"
    QUICK_STOP = "quick stop ramp"
    CURRENT_LIMIT = "current limit"


@dataclass(frozen=True, slots=True)
class OptionCode:
    """One object: its value in a drive that lacks it, and what each value means."""

    default: int
    actions: Mapping[int, Braking | Command | State | None]
    """A braking, or of 6007h a device control command, the state that begins a fault, or nothing."""


_RAMPS: Final = {1: Braking.SLOW_DOWN, 2: Braking.QUICK_STOP, 3: Braking.CURRENT_LIMIT}
_FREE: Final = {0: Braking.NONE}
OPTION_CODES: Final[Mapping[int, OptionCode]] = {
    ABORT_OPTION: OptionCode(
        1, {0: None, 1: State.FAULT_REACTION_ACTIVE, 2: Command.DISABLE_VOLTAGE, 3: Command.QUICK_STOP}
    ),
    QUICK_STOP_OPTION: OptionCode(2, _FREE | _RAMPS | {code + 4: ramp for code, ramp in _RAMPS.items()}),
    SHUTDOWN_OPTION: OptionCode(0, {0: Braking.NONE, 1: Braking.SLOW_DOWN}),
    DISABLE_OPERATION_OPTION: OptionCode(1, {0: Braking.NONE, 1: Braking.SLOW_DOWN}),
    HALT_OPTION: OptionCode(1, _FREE | _RAMPS),
    FAULT_REACTION_OPTION: OptionCode(2, _FREE | _RAMPS),
}
"""By index. The object dictionary of a drive has its limits from here."""
STAYS_STOPPED: Final = 5
"""605Ah from this value on: the drive stays in Quick Stop Active."""


def limits(index: int) -> tuple[int, int]:
    """Lowest and highest value that is simulated. Values between them may be refused."""
    actions = OPTION_CODES[index].actions
    return min(actions), max(actions)


def is_simulated(index: int, value: object) -> bool:
    """Whether an object is none of them, or the value has a meaning here."""
    return index not in OPTION_CODES or value in OPTION_CODES[index].actions
