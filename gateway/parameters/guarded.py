"""Objects that must not change while an axis is powered: they stop it, guard it, or define its values.

Such a write over the parameter channel could remove the brake of a turning axis, so it is refused. After a write while the axis
is off, the gateway checks its copy of these objects before the axis may be switched on.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass

from pdgw.ds301.communication import (
    EMCY_COB_ID,
    ERROR_BEHAVIOUR,
    NMT_STARTUP,
    PRODUCER_HEARTBEAT,
    RESTORE_PARAMETERS,
    SDO_CLIENTS,
    SDO_SERVERS,
    STORE_PARAMETERS,
    SYNC_COB_ID,
    SYNC_COUNTER,
    SYNC_WINDOW,
)
from pdgw.ds301.pdo import PDO_PARAMETERS
from pdgw.dsp402 import objects
from pdgw.dsp406.objects import MEASURING_STEPS, OPERATING_PARAMETERS, PRESET_MULTI_SENSOR


class Check(enum.Enum):
    """Checks after a write, before the axis may be switched on again."""

    NOTHING = "nothing: the gateway has no copy of it"
    REFERENCES = "the gateway reads the references again"
    CONFIGURATION = "the gateway configures the node again: identity, PDOs, guarding, references"


@dataclass(frozen=True, slots=True)
class GuardedRange:
    """Objects ``first`` to ``last``, and why they are guarded."""

    first: int
    last: int
    reason: str
    check: Check


GUARDED: tuple[GuardedRange, ...] = (
    GuardedRange(SYNC_COB_ID, SYNC_WINDOW, "SYNC: TPDOs that wait for SYNC would stop", Check.CONFIGURATION),
    GuardedRange(
        STORE_PARAMETERS, STORE_PARAMETERS, "storing: the drive may not react to a stop while it stores", Check.NOTHING
    ),
    GuardedRange(
        RESTORE_PARAMETERS, RESTORE_PARAMETERS, "restoring: changes all parameters below", Check.CONFIGURATION
    ),
    GuardedRange(
        EMCY_COB_ID,
        PRODUCER_HEARTBEAT,
        "EMCY and heartbeats: faults would not be reported, and the loss of the gateway would not be noticed",
        Check.CONFIGURATION,
    ),
    GuardedRange(
        SYNC_COUNTER, SYNC_COUNTER, "counter of SYNC: TPDOs that wait for SYNC would stop", Check.CONFIGURATION
    ),
    GuardedRange(ERROR_BEHAVIOUR, ERROR_BEHAVIOUR, "error behaviour of the node: its PDOs may stop", Check.NOTHING),
    GuardedRange(
        SDO_SERVERS[0], SDO_SERVERS[-1], "SDO servers: the gateway would lose its access", Check.CONFIGURATION
    ),
    GuardedRange(
        SDO_CLIENTS[0], SDO_CLIENTS[-1], "SDO clients: the drive would write to other nodes", Check.CONFIGURATION
    ),
    GuardedRange(
        PDO_PARAMETERS[0],
        PDO_PARAMETERS[-1],
        "PDOs: the drive would not receive its stop, or the gateway would not see it",
        Check.CONFIGURATION,
    ),
    GuardedRange(NMT_STARTUP, NMT_STARTUP, "NMT start-up: the drive would start by itself", Check.CONFIGURATION),
    GuardedRange(
        OPERATING_PARAMETERS,
        MEASURING_STEPS,
        "resolution, range and preset of an encoder: its position jumps",
        Check.REFERENCES,
    ),
    GuardedRange(
        objects.ABORT_OPTION, objects.ABORT_OPTION, "reaction of the drive when the gateway dies", Check.CONFIGURATION
    ),
    GuardedRange(
        PRESET_MULTI_SENSOR, PRESET_MULTI_SENSOR, "presets of an encoder: its position jumps", Check.REFERENCES
    ),
    GuardedRange(objects.VL_MIN_MAX, objects.VL_MIN_MAX, "speed limits: value of 100 %", Check.REFERENCES),
    GuardedRange(
        objects.VL_DECELERATION,
        objects.VL_QUICK_STOP,
        "deceleration and quick stop of velocity mode: braking",
        Check.REFERENCES,
    ),
    GuardedRange(
        objects.VL_SETPOINT_FACTOR,
        objects.VL_DIMENSION_FACTOR,
        "factors of velocity mode: meaning of every speed",
        Check.REFERENCES,
    ),
    GuardedRange(
        objects.QUICK_STOP_OPTION,
        objects.FAULT_REACTION_OPTION,
        "reaction to quick stop, shutdown, disable, Halt and faults",
        Check.REFERENCES,
    ),
    GuardedRange(
        objects.RATED_CURRENT,
        objects.RATED_TORQUE,
        "rated current and torque: meaning of every current, torque and limit",
        Check.NOTHING,
    ),
    GuardedRange(
        objects.POSITION_RANGE_LIMIT,
        objects.POSITION_RANGE_LIMIT,
        "range of positions: value of 100 %, and where they wrap",
        Check.REFERENCES,
    ),
    GuardedRange(
        objects.HOME_OFFSET,
        objects.HOME_OFFSET,
        "home offset: zero of every position; the home position is lost",
        Check.CONFIGURATION,
    ),
    GuardedRange(objects.POLARITY, objects.POLARITY, "polarity: sign of every value", Check.REFERENCES),
    GuardedRange(
        objects.MAX_PROFILE_VELOCITY, objects.MAX_MOTOR_SPEED, "speed limits: value of 100 %", Check.REFERENCES
    ),
    GuardedRange(
        objects.PROFILE_DECELERATION,
        objects.MOTION_PROFILE_TYPE,
        "deceleration, quick stop deceleration and ramp type: braking",
        Check.REFERENCES,
    ),
    GuardedRange(
        objects.POSITION_NOTATION,
        objects.ACCELERATION_FACTOR,
        "units, resolutions, ratios and factors: meaning of every value",
        Check.REFERENCES,
    ),
    GuardedRange(
        objects.SI_UNIT_POSITION,
        objects.SI_UNIT_ACCELERATION,
        "units of position, velocity and acceleration: meaning of every value",
        Check.REFERENCES,
    ),
    GuardedRange(
        objects.INTERPOLATION_TIME,
        objects.INTERPOLATION_TIME,
        "interpolation time: speed between two positions",
        Check.CONFIGURATION,
    ),
    GuardedRange(objects.MAX_DECELERATION, objects.MAX_DECELERATION, "maximum deceleration: braking", Check.REFERENCES),
    GuardedRange(
        objects.POSITIONING_OPTION,
        objects.POSITIONING_OPTION,
        "positioning option code: where a relative task begins, and the direction to a target",
        Check.CONFIGURATION,
    ),
)
"""In the order of their indices; everything else may be written at any time."""


def guard_of(index: int) -> GuardedRange | None:
    """The range an object is in, None for an object that is not guarded."""
    return next((item for item in GUARDED if item.first <= index <= item.last), None)
