"""Each setpoint and bit of every telegram: the orders whose rows watch it, or why none is needed.

``test_orders`` finds what is in no entry. Source: docs/translation.md, docs/telegrams.md, docs/motion.md.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from pdgw.gateway.axis.orders import Order
from pdgw.gateway.axis.telegrams import (
    DSC_TELEGRAM_NUMBERS,
    ENCODER_TELEGRAM_NUMBERS,
    POSITIONER_TELEGRAM_NUMBERS,
    SPEED_TELEGRAM_NUMBERS,
    TASK_TELEGRAM_NUMBERS,
)
from pdgw.profidrive.telegrams import TELEGRAMS, ApplicationMode, telegram

SPEED = tuple(SPEED_TELEGRAM_NUMBERS)
DSC = tuple(DSC_TELEGRAM_NUMBERS)
TASKS = tuple(TASK_TELEGRAM_NUMBERS)
POSITIONERS = tuple(POSITIONER_TELEGRAM_NUMBERS)
STW1 = (*SPEED, *DSC, *TASKS)
ALL = tuple(TELEGRAMS)
RAW = (100,)

_NOT_READ = "the gateway does not read it"
_WITH_EDGE = "is read with the edge of STW1.6 alone; the task that runs keeps what it had"
_MEASURES = "a request to a sensor, which moves nothing"
_KIND_OF_JOG = "the kind of the next jog; it is read at the edge of its bit"


@dataclass(frozen=True)
class Entry:
    """Signals, or bits as ``STW1.ON``, of some telegrams. ``why``: no order watches them; else ``orders`` do."""

    names: str
    telegrams: tuple[int, ...]
    orders: tuple[Order, ...] = ()
    why: str = ""


ENTRIES = (
    # -- STW1 ---------------------------------------------------------------------------------------------------------
    Entry("STW1.ON", STW1, (Order.RAMP,)),
    Entry("STW1.NO_COAST_STOP", STW1, (Order.OFF2,)),
    Entry("STW1.NO_QUICK_STOP", STW1, (Order.STOP,)),
    Entry("STW1.ENABLE_OPERATION", STW1, (Order.ENTER, Order.DISABLE)),
    Entry("STW1.CONTROL_BY_PLC", STW1, (Order.RAMP,)),
    Entry("STW1.FAULT_ACKNOWLEDGE", STW1, why="starts and stops nothing: a start needs OFF and ON"),
    Entry("STW1.ENABLE_RAMP_GENERATOR STW1.ENABLE_SETPOINT", SPEED, (Order.ZERO,)),
    Entry(
        "STW1.UNFREEZE_RAMP_GENERATOR",
        (*SPEED, *DSC),
        why="0 keeps the speed of its moment, which the row `setpoint` watches; it ends no motion",
    ),
    Entry("STW1.ENABLE_RAMP_GENERATOR STW1.ENABLE_SETPOINT", DSC, why="no effect: NSOLL_B is in force in any case"),
    Entry("STW1.JOG_1_ON STW1.JOG_2_ON", (*SPEED, *POSITIONERS), (Order.ZERO,)),
    Entry("STW1.JOG_1_ON STW1.JOG_2_ON", (*DSC, 9), why=_NOT_READ),
    Entry("STW1.DEVICE_11", (*SPEED, *DSC), why=_NOT_READ),
    Entry(
        "STW1.DEVICE_12 STW1.DEVICE_13 STW1.DEVICE_14 STW1.DEVICE_15",
        SPEED,
        why="bits of the manufacturer in the Controlword: only its manual says what follows",
    ),
    Entry("STW1.DEVICE_12 STW1.DEVICE_13 STW1.DEVICE_14 STW1.DEVICE_15", DSC, why=_NOT_READ),
    Entry("STW1.DO_NOT_REJECT STW1.NO_INTERMEDIATE_STOP", POSITIONERS, (Order.HALT, Order.ZERO)),
    Entry("STW1.DO_NOT_REJECT STW1.NO_INTERMEDIATE_STOP", (9,), (Order.HALT,)),
    Entry("STW1.ACTIVATE_TASK", TASKS, (Order.SETPOINT,)),
    Entry("STW1.START_HOMING", TASKS, (Order.HALT,)),
    Entry("STW1.OPEN_BRAKE STW1.DEVICE_14 STW1.DEVICE_15", TASKS, why=_NOT_READ),
    Entry("STW1.EXTERNAL_BLOCK_CHANGE", (9,), why=_NOT_READ),
    Entry("STW1.EXTERNAL_BLOCK_CHANGE", POSITIONERS, why="the next block of a chain: a task as with STW1.6"),
    # -- STW2 and the sensors -----------------------------------------------------------------------------------------
    Entry("STW2.SIGN_OF_LIFE", ALL, why="its end (P925) counts as the loss of the PLC"),
    Entry("STW2.DATA_SET STW2.PARK_AXIS", ALL, why=_NOT_READ),
    Entry("STW2.TO_FIXED_STOP", (*SPEED, *DSC, 9), why=_NOT_READ),
    Entry("STW2.TO_FIXED_STOP", POSITIONERS, why="lowers the torque of the next task; it ends no motion"),
    Entry(
        " ".join(
            f"G{number}_STW.{bit}"
            for number in (1, 2)
            for bit in (
                *(f"FUNCTION_{place}" for place in (1, 2, 3, 4)),
                *("COMMAND", "MODE", "PRESET_RELATIVE", "PRESET", "REQUEST_ABSOLUTE", "PARK", "ERROR_ACKNOWLEDGE"),
            )
        ),
        ALL,
        why=_MEASURES,
    ),
    Entry(
        "STW2_ENC.FAULT_ACKNOWLEDGE STW2_ENC.CONTROL_BY_PLC STW2_ENC.SIGN_OF_LIFE",
        tuple(ENCODER_TELEGRAM_NUMBERS),
        why="an encoder moves nothing",
    ),
    # -- speeds -------------------------------------------------------------------------------------------------------
    Entry("NSOLL_A NSOLL_B", (*SPEED, *DSC), (Order.ZERO, Order.SETPOINT)),
    Entry("MOMRED", ALL, why="a limit of the torque; a speed that it explains is warning 112"),
    Entry("XERR", DSC, (Order.SETPOINT,)),
    Entry("KPC", DSC, (Order.ZERO,)),
    # -- positions ----------------------------------------------------------------------------------------------------
    Entry("SATZANW.MDI", (9,), (Order.HALT,)),
    Entry("SATZANW.HOMING_METHOD", (9,), why="is read with the edge of STW1.11 alone"),
    Entry("SATZANW.BLOCK", (7, 110), (Order.SETPOINT,)),
    Entry("POS_STW1.BLOCK", (111, 112), (Order.SETPOINT,)),
    Entry("SATZANW.MDI", (7, 110), why=_WITH_EDGE),
    Entry("POS_STW1.MDI POS_STW1.SETTING_UP", (111, 112), why=_WITH_EDGE),
    Entry("OVERRIDE", POSITIONERS, (Order.HALT, Order.ZERO, Order.SETPOINT)),
    Entry("MDI_VELOCITY MDI_VELOCITY_F", TASKS, (Order.SETPOINT,)),
    Entry(
        "MDI_TARPOS MDI_TARPOS_F",
        TASKS,
        why="ends no motion: the drive keeps its last target until it acknowledges another, warning 129 after 2 s",
    ),
    Entry("MDI_ACC MDI_ACC_F", TASKS, why="too slow an acceleration is no danger"),
    Entry("MDI_DEC MDI_DEC_F", TASKS, why="is the ramp that the row `halt` allows"),
    Entry("MDI_MOD.ABSOLUTE MDI_MOD.POSITIVE_DIRECTION MDI_MOD.NEGATIVE_DIRECTION", (9, 110), why=_WITH_EDGE),
    Entry("POS_STW1.POSITIVE_DIRECTION POS_STW1.NEGATIVE_DIRECTION", (111, 112), (Order.SETPOINT,)),
    Entry("POS_STW1.ABSOLUTE", (111, 112), why=_WITH_EDGE),
    Entry("POS_STW1.CONTINUOUS_UPDATE", (111, 112), (Order.SETPOINT,)),
    Entry("POS_STW.TRACKING POS_STW2.TRACKING", (110, 111, 112), why="acts only without a function, at standstill"),
    Entry("POS_STW.SET_REFERENCE_POINT POS_STW2.SET_REFERENCE_POINT", (110, 111, 112), why="moves nothing"),
    Entry("POS_STW.REFERENCE_CAM POS_STW2.REFERENCE_CAM", (110, 111, 112), why=_NOT_READ),
    Entry("POS_STW.JOG_INCREMENTAL POS_STW2.JOG_INCREMENTAL", (110, 111, 112), why=_KIND_OF_JOG),
    Entry(
        "POS_STW2.PASSIVE_HOMING POS_STW2.HOMING_NEGATIVE POS_STW2.PROBE_2 POS_STW2.PROBE_FALLING_EDGE",
        (111, 112),
        why="the kind of the next homing",
    ),
    Entry(
        "POS_STW2.SOFTWARE_LIMITS POS_STW2.HARDWARE_LIMITS",
        (111, 112),
        why="a limit that is reached acts as STW1.5 = 0",
    ),
    Entry("REF_COORDINATE", (112,), why="moves nothing"),
    Entry("USER RESERVED_2", TASKS, why="without a meaning for the gateway"),
    # -- telegram 100 -------------------------------------------------------------------------------------------------
    Entry(
        "Controlword;Modes of Operation.MODE;Modes of Operation.RESERVED;Target Torque;Target Position;Profile Velocity;"
        "Profile Acceleration;Profile Deceleration;Dynamic Speed Limit;Dynamic Torque Limit;Digital Outputs;"
        "Digital Outputs Mask;Target Velocity",
        RAW,
        why="the PLC commands the drive itself: only the loss of the PLC and the gateway's own stops are watched",
    ),
)


def names_of(entry: Entry) -> list[str]:
    """The names of an entry; those of telegram 100 contain spaces."""
    return entry.names.split(";" if ";" in entry.names else None)


def ordered_by(number: int) -> Iterator[str]:
    """Each setpoint of a telegram, or each of its bits."""
    chosen = telegram(number)
    positioning = chosen.mode is ApplicationMode.POSITIONING
    for item in chosen.setpoints.signals:
        bits = tuple(item.fields(positioning=positioning))
        if bits:
            yield from (f"{item.name}.{bit.name}" for bit in bits)
        else:
            yield item.name


def entries(number: int, name: str) -> list[Entry]:
    """The entries of a setpoint or bit of a telegram: exactly one is right."""
    return [entry for entry in ENTRIES if number in entry.telegrams and name in names_of(entry)]
