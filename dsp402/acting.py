"""What acts in a mode of operation: the objects that are its setpoint, add to it, turn it round, limit it, or decide a stop.

Each object has a treatment in each mode, so that no value that another master has left acts unseen. Where an RPDO of the
telegram contains an object, the gateway commands it, whatever this table says. In telegram 100 the PLC chooses the mode: nothing
is set, and everything is shown. Source: CiA 402-2 (the control function of each mode, 60F2h), CiA DSP 402 V2.0 (605Dh = 0).

Factors, notations and resolutions are missing: they are units, which ``dsp402.units`` compares. So are objects that only change
what the Statusword shows.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Collection, Container, Iterable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from pdgw.ds301.objects import Entry, ObjectAddress
from pdgw.dsp402 import objects
from pdgw.dsp402.drive_type import Dsp402Error
from pdgw.dsp402.modes import Mode


class Effect(enum.Enum):
    """What an object does in a mode; the value begins a line for the user."""

    SETPOINT = "setpoints"
    ADDS = "offsets"
    DIRECTION = "direction"
    LIMITS = "limits"
    STOPS = "stops"


class Treatment(enum.Enum):
    """What the gateway does with an object that no RPDO contains."""

    COMMANDED = "commanded"
    """It is in an RPDO of each telegram with the mode, or the gateway writes it by SDO."""
    ZERO = "0 before ON"
    COMPARED = "compared, refused"
    SHOWN = "left to the drive, shown"


@dataclass(frozen=True, slots=True)
class Acting:
    """One object, or bits of it, in modes of operation."""

    entry: Entry
    modes: frozenset[Mode]
    effect: Effect
    treatment: Treatment
    why: str = ""
    """What a value does that must not stay; empty if any may."""
    mask: int = -1
    """The bits that count."""
    right: int = 0
    """Their value that the gateway sets, or that a refusal asks for."""
    wrong: int | None = None
    """The only wrong value; None: all but ``right``."""

    @property
    def address(self) -> ObjectAddress:
        """Index and sub-index."""
        return self.entry.address

    def fits(self, value: int) -> bool:
        """Whether a value of the object may stay."""
        bits = value & self.mask
        return not self.why or (bits == self.right if self.wrong is None else bits != self.wrong)

    def corrected(self, value: int) -> int:
        """The value with the right bits."""
        return value & ~self.mask | self.right

    def check(self, found: Mapping[ObjectAddress, int]) -> None:
        """Dsp402Error if the value that was found must not stay."""
        value = found.get(self.address)
        if value is not None and not self.fits(value):
            right = self.corrected(value)
            command = f"pdgw param write {self.entry.index:04X}h {right}"
            raise Dsp402Error(str(self.entry), value, f"{right} ({command}): {self.why}")


Found = dict[ObjectAddress, int | None]
"""Values by object; None: it exists and cannot be read now."""
_SPECS: Final = {spec.index: spec for spec in (*objects.DRIVE_OBJECTS.objects, *objects.FURTHER_OBJECTS)}


def _rows(effect: Effect, treatment: Treatment, modes: Iterable[Mode], *indices: int) -> Iterator[Acting]:
    """Objects with all of their sub-indices."""
    chosen = frozenset(modes)
    for index in indices:
        entries = _SPECS[index].entries
        yield from (Acting(entry, chosen, effect, treatment) for entry in (entries[1:] or entries))


def _option(index: int, modes: Iterable[Mode], effect: Effect, treatment: Treatment, why: str, **bits: int) -> Acting:
    return Acting(_SPECS[index].entries[0], frozenset(modes), effect, treatment, why, **bits)


M, E, T = Mode, Effect, Treatment
_ALL: Final = tuple(Mode)
_POSITIONS: Final = (M.POSITION, M.CYCLIC_POSITION)
_VELOCITIES: Final = (M.VELOCITY, M.CYCLIC_VELOCITY)
_TORQUES: Final = (M.TORQUE, M.CYCLIC_TORQUE)
_CYCLIC: Final = (M.CYCLIC_POSITION, M.CYCLIC_VELOCITY, M.CYCLIC_TORQUE)
_PROFILE: Final = (M.POSITION, M.VELOCITY, M.HOMING)
"""Modes with a ramp of the drive, in which telegrams stop by Halt."""
_MOTIONS: Final = (*_PROFILE, M.CYCLIC_POSITION, M.CYCLIC_VELOCITY)
_VL: Final = (M.VL_VELOCITY,)

HALT_SWITCHES_OFF: Final = _option(
    objects.HALT_OPTION,
    _PROFILE,
    E.STOPS,
    T.COMPARED,
    "with 0 each Halt switches the drive off, and the motor coasts",
    right=1,
    wrong=0,
)
"""Compared by the telegrams that stop by Halt: 7, 9, 110 to 112, and 100 with ``on_plc_loss = "ramp"``."""
TURNS_ROUND: Final = _option(
    objects.POSITIONING_OPTION,
    (M.POSITION,),
    E.DIRECTION,
    T.COMPARED,
    "bits 6 and 7 change the direction to a target",
    mask=0b1100_0000,
)
"""The gateway clears the bits of an axis whose direction it chooses (modulo), and compares them otherwise."""
ADDED_TO_TARGET: Final = _option(
    objects.POSITIONING_OPTION,
    (M.POSITION,),
    E.ADDS,
    T.COMMANDED,
    "relative tasks may begin at the last target, also after a stop",
    mask=0b11,
    right=0b01,
)
"""A relative task begins at the demanded position. A drive that keeps other bits can be operated, with a note."""

ACTING: Final = (
    *_rows(E.SETPOINT, T.COMMANDED, _POSITIONS, objects.TARGET_POSITION),
    *_rows(E.SETPOINT, T.COMMANDED, _VELOCITIES, objects.TARGET_VELOCITY),
    *_rows(E.SETPOINT, T.COMMANDED, _VL, objects.VL_TARGET_VELOCITY),
    *_rows(E.SETPOINT, T.COMMANDED, _TORQUES, objects.TARGET_TORQUE),
    *_rows(E.SETPOINT, T.COMMANDED, (M.HOMING,), objects.HOMING_METHOD[0]),
    *_rows(E.SETPOINT, T.SHOWN, (M.HOMING,), objects.HOMING_SPEEDS),
    *_rows(E.SETPOINT, T.COMMANDED, _CYCLIC, objects.INTERPOLATION_TIME),
    _option(objects.POSITION_OFFSET, (M.CYCLIC_POSITION,), E.ADDS, T.ZERO, "the drive adds it to Target Position"),
    *_rows(E.ADDS, T.COMMANDED, (M.CYCLIC_POSITION,), objects.VELOCITY_OFFSET),
    _option(objects.VELOCITY_OFFSET, (M.CYCLIC_VELOCITY,), E.ADDS, T.ZERO, "the drive adds it to Target Velocity"),
    *_rows(E.ADDS, T.SHOWN, _CYCLIC, objects.TORQUE_OFFSET),
    _option(objects.END_VELOCITY, (M.POSITION,), E.ADDS, T.ZERO, "the drive passes its target with this velocity"),
    ADDED_TO_TARGET,
    *_rows(E.ADDS, T.SHOWN, (*_POSITIONS, M.HOMING), objects.HOME_OFFSET),
    TURNS_ROUND,
    *_rows(E.DIRECTION, T.SHOWN, _MOTIONS, objects.POLARITY),
    *_rows(E.LIMITS, T.COMMANDED, (M.POSITION,), objects.PROFILE_VELOCITY),
    *_rows(E.LIMITS, T.COMMANDED, (M.POSITION,), objects.PROFILE_ACCELERATION, objects.PROFILE_DECELERATION),
    *_rows(E.LIMITS, T.SHOWN, (M.VELOCITY,), objects.PROFILE_ACCELERATION, objects.PROFILE_DECELERATION),
    *_rows(E.LIMITS, T.SHOWN, (M.HOMING,), objects.HOMING_ACCELERATION),
    *_rows(E.LIMITS, T.SHOWN, _PROFILE, objects.MOTION_PROFILE_TYPE, objects.PROFILE_JERK),
    *_rows(E.LIMITS, T.SHOWN, _ALL, objects.MAX_TORQUE[0], objects.MAX_CURRENT, objects.MAX_MOTOR_SPEED),
    *_rows(E.LIMITS, T.SHOWN, _ALL, objects.POSITIVE_TORQUE_LIMIT, objects.NEGATIVE_TORQUE_LIMIT),
    *_rows(E.LIMITS, T.SHOWN, (M.TORQUE,), objects.TORQUE_SLOPE),
    *_rows(E.LIMITS, T.SHOWN, _MOTIONS, objects.MAX_PROFILE_VELOCITY),
    *_rows(E.LIMITS, T.SHOWN, _MOTIONS, objects.MAX_ACCELERATION, objects.MAX_DECELERATION),
    *_rows(E.LIMITS, T.SHOWN, _POSITIONS, objects.POSITION_RANGE_LIMIT),
    *_rows(E.LIMITS, T.SHOWN, (*_POSITIONS, *_VELOCITIES), objects.SOFTWARE_POSITION_LIMIT),
    *_rows(E.LIMITS, T.SHOWN, _VL, objects.VL_MIN_MAX, objects.VL_MIN_MAX_BY_DIRECTION),
    *_rows(E.LIMITS, T.SHOWN, _VL, objects.VL_ACCELERATION, objects.VL_DECELERATION),
    *_rows(E.STOPS, T.COMMANDED, _ALL, objects.ABORT_OPTION),
    *_rows(E.STOPS, T.SHOWN, _ALL, objects.QUICK_STOP_OPTION, objects.FAULT_REACTION_OPTION),
    *_rows(E.STOPS, T.SHOWN, _ALL, objects.SHUTDOWN_OPTION, objects.DISABLE_OPERATION_OPTION),
    HALT_SWITCHES_OFF,
    *_rows(E.STOPS, T.SHOWN, (*_VL, *_TORQUES, *_CYCLIC), objects.HALT_OPTION),
    *_rows(E.STOPS, T.SHOWN, (*_MOTIONS, *_TORQUES), objects.QUICK_STOP_DECELERATION),
    *_rows(E.STOPS, T.SHOWN, _VL, objects.VL_QUICK_STOP),
    *_rows(E.STOPS, T.SHOWN, (*_POSITIONS, M.HOMING), objects.FOLLOWING_ERROR_WINDOW, objects.FOLLOWING_ERROR_TIME),
    *_rows(E.STOPS, T.SHOWN, _VELOCITIES, objects.MAX_SLIPPAGE),
)
"""Every object in every mode in which it acts."""
ASKED: Final = frozenset(row.address for row in ACTING if row.why or row.treatment is not T.COMMANDED)
"""Objects of which the gateway must know what the drive has."""
KEPT: Final = frozenset(
    row.entry.attribute for row in ACTING if row.entry.attribute and row.effect in (E.ADDS, E.LIMITS)
)
"""Image attributes of what also acts without an RPDO: the drive's own value returns when no RPDO contains it any more."""


def acting_in(modes: Collection[int]) -> tuple[Acting, ...]:
    """The objects that act in one of these modes (6060h)."""
    return tuple(row for row in ACTING if not row.modes.isdisjoint(modes))


def read_acting(
    rows: Iterable[Acting],
    in_data_sheet: Container[int],
    read: Callable[[int, int], bytes | None],
    known: Mapping[ObjectAddress, int],
) -> Found:
    """What the drive has of these objects.

    ``in_data_sheet``: indices; an object whose value may be wrong is read in any case. ``read``: None for an object that is not
    there, nothing for one that cannot be read now. ``known``: what was read already.
    """
    found: Found = {}
    for row in rows:
        address, entry = row.address, row.entry
        if address in found or address not in ASKED:
            continue
        if address in known:
            found[address] = known[address]
        elif (row.why or entry.index in in_data_sheet) and (data := read(*address)) is not None:
            size, signed = entry.type.bits // 8, entry.type.char.islower()
            found[address] = int.from_bytes(data[:size], "little", signed=signed) if data else None
    return found


def readable(found: Found) -> Mapping[ObjectAddress, int]:
    """The values that are known."""
    return MappingProxyType({address: value for address, value in found.items() if value is not None})


def left_to_the_drive(
    found: Mapping[ObjectAddress, int], modes: Collection[int], commanded: Collection[ObjectAddress]
) -> tuple[str, ...]:
    """For the user: a line for each effect with the objects that the gateway does not command, and the values found.

    ``commanded``: objects of the RPDOs, or written in their place. Offsets of 0 are left out.
    """
    texts: dict[Effect, dict[str, int]] = {effect: {} for effect in Effect}
    for row in acting_in(modes):
        value = found.get(row.address)
        is_left = row.treatment is not T.COMMANDED and row.address not in commanded
        if is_left and value is not None and (value or row.effect is not E.ADDS):
            texts[row.effect][str(row.entry)] = value
    return tuple(
        f"{effect.value} of the drive: {', '.join(f'{name} = {value}' for name, value in values.items())}"
        for effect, values in texts.items()
        if values
    )
