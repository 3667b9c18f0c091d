"""PDO layouts of the drive: which objects travel in which PDO for a given kind of operation.

Source: translation decisions (docs/translation.md, PDO layouts). Keys name the operation; who owns the drive
chooses.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace

from pdgw.ds301.objects import Entry
from pdgw.ds301.pdo import PDO_BYTES, Pdo, PdoDirection, PdoLayout
from pdgw.dsp402.objects import DRIVE_OBJECTS, FAMILY_VALUES

__all__ = [
    "LAYOUTS",
    "Operation",
    "PdoLayout",
    "pdo",
    "with_objects",
    "with_second_position",
    "without",
    "without_position",
]


class Operation(enum.Enum):
    """The kind of operation of the drive, which decides the contents of its PDOs."""

    VELOCITY = "velocity"
    VELOCITY_WITH_POSITION = "velocity with position"
    VELOCITY_WITH_TORQUE = "velocity with torque limit"
    """And with what a message word is made from."""
    VELOCITY_WITH_LOAD = "velocity with load"
    """And with the current, if the drive reports it."""
    POSITIONING = "positioning"
    POSITIONER = "positioner"
    """Positions and speeds in turn, with what a message word is made from."""
    CYCLIC_POSITION = "cyclic synchronous position"
    CYCLIC_VELOCITY = "cyclic synchronous velocity"
    TRANSPARENT = "transparent"


def pdo(direction: PdoDirection, number: int, *attributes: str) -> Pdo:
    """A PDO of objects, named by their image attributes; those of a family have no address yet."""
    entries = tuple(FAMILY_VALUES.get(name) or DRIVE_OBJECTS.attribute(name) for name in attributes)
    return Pdo(direction, number, entries)


_R = PdoDirection.RPDO
_T = PdoDirection.TPDO

_WITH_MESSAGES = (
    pdo(_T, 1, "statusword", "velocity_actual"),
    pdo(_T, 2, "position_actual", "velocity_demand"),
    pdo(_T, 3, "current_actual"),
)
_DEMAND = {"velocity_demand": "the bit for speed within tolerance is 0; a frozen ramp keeps the actual speed"}
_MESSAGES = {
    "velocity_demand": "the bits for ramp completed and speed within tolerance are 0",
    "current_actual": "the bit for torque below its threshold is 0",
}
_TASKS = {
    "profile_velocity": "traversing tasks run at the drive's own velocity: only tasks with 100 % are possible",
    "profile_deceleration": "6083h contains the smaller of acceleration and deceleration, and applies to both",
}

LAYOUTS: dict[Operation, PdoLayout] = {
    # RPDO 1 has the Controlword as its last object and is sent last: a drive that applies objects in mapping order would
    # otherwise start towards the previous target.
    Operation.VELOCITY: PdoLayout(
        rpdos=(pdo(_R, 1, "target_velocity", "controlword"),),
        tpdos=(pdo(_T, 1, "statusword", "velocity_actual"), pdo(_T, 2, "velocity_demand")),
        optional=_DEMAND,
        cyclic_only=frozenset(_DEMAND),
    ),
    Operation.VELOCITY_WITH_POSITION: PdoLayout(
        rpdos=(pdo(_R, 1, "target_velocity", "controlword"),),
        tpdos=(pdo(_T, 1, "statusword", "velocity_actual"), pdo(_T, 2, "position_actual", "velocity_demand")),
        optional=_DEMAND,
        cyclic_only=frozenset(_DEMAND),
    ),
    Operation.VELOCITY_WITH_TORQUE: PdoLayout(
        rpdos=(pdo(_R, 1, "target_velocity", "controlword"), pdo(_R, 2, "max_torque")),
        tpdos=_WITH_MESSAGES,
        optional=_MESSAGES,
    ),
    Operation.VELOCITY_WITH_LOAD: PdoLayout(
        rpdos=(pdo(_R, 1, "target_velocity", "controlword"),),
        tpdos=(pdo(_T, 1, "statusword", "velocity_actual"), pdo(_T, 2, "current_actual", "velocity_demand")),
        optional={**_DEMAND, "current_actual": "current, torque and power are 0"},
        cyclic_only=frozenset(_DEMAND),
    ),
    Operation.POSITIONING: PdoLayout(
        rpdos=(
            pdo(_R, 1, "target_position", "modes_of_operation", "controlword"),
            pdo(_R, 2, "profile_velocity"),
            pdo(_R, 3, "profile_acceleration", "profile_deceleration"),
        ),
        tpdos=(
            pdo(_T, 1, "statusword", "modes_of_operation_display", "position_actual"),
            pdo(_T, 2, "velocity_actual"),
        ),
        optional=_TASKS,
    ),
    Operation.POSITIONER: PdoLayout(
        rpdos=(
            pdo(_R, 1, "target_position", "modes_of_operation", "controlword"),
            pdo(_R, 2, "profile_velocity", "target_velocity"),
            pdo(_R, 3, "profile_acceleration", "profile_deceleration"),
        ),
        tpdos=(
            pdo(_T, 1, "statusword", "modes_of_operation_display", "position_actual"),
            pdo(_T, 2, "velocity_actual", "velocity_demand"),
            pdo(_T, 3, "digital_inputs", "current_actual"),
        ),
        optional={**_MESSAGES, **_TASKS, "digital_inputs": "the limit switches are 0"},
    ),
    Operation.CYCLIC_POSITION: PdoLayout(
        rpdos=(
            pdo(_R, 1, "target_position", "controlword"),
            pdo(_R, 2, "velocity_offset", "max_torque"),
        ),
        tpdos=_WITH_MESSAGES,
        optional=_MESSAGES,
    ),
    Operation.CYCLIC_VELOCITY: PdoLayout(
        rpdos=(pdo(_R, 1, "target_velocity", "controlword"), pdo(_R, 2, "max_torque")),
        tpdos=_WITH_MESSAGES,
        optional=_MESSAGES,
    ),
    Operation.TRANSPARENT: PdoLayout(
        rpdos=(
            pdo(_R, 1, "target_torque", "modes_of_operation", "controlword"),
            pdo(_R, 2, "target_position", "target_velocity"),
            pdo(_R, 3, "profile_velocity", "profile_acceleration"),
            pdo(_R, 4, "profile_deceleration", "dynamic_speed_limit", "dynamic_torque_limit"),
            pdo(_R, 5, "digital_outputs", "digital_outputs_mask"),
        ),
        tpdos=(
            pdo(_T, 1, "statusword", "modes_of_operation_display", "current_actual", "error_code"),
            pdo(_T, 2, "position_actual", "velocity_actual"),
            pdo(_T, 3, "velocity_demand", "dc_link_voltage"),
            pdo(_T, 4, "digital_inputs", "analogue_input_1", "analogue_input_2"),
            pdo(_T, 5, "encoder_position"),
        ),
    ),
}


def with_objects(layout: PdoLayout, entries: Mapping[str, Entry]) -> PdoLayout:
    """The layout with objects replaced by image attribute, for example by those of a family (``Overlay.entries``)."""
    return _with(layout, lambda entry: entries.get(entry.attribute, entry))


def with_second_position(layout: PdoLayout) -> PdoLayout:
    """The layout with the position of the drive's second encoder (60E4h) in its last TPDO, or in an additional one."""
    *tpdos, last = layout.tpdos
    own = pdo(last.direction, last.number + 1, "second_position")
    if last.size + own.size > PDO_BYTES:
        return replace(layout, tpdos=(*layout.tpdos, own))
    return replace(layout, tpdos=(*tpdos, pdo(last.direction, last.number, *last.attributes, "second_position")))


def without_position(layout: PdoLayout) -> PdoLayout:
    """The layout without the drive's position (6064h)."""
    return without(layout, {"position_actual"})


def without(layout: PdoLayout, attributes: Collection[str]) -> PdoLayout:
    """The layout without the objects of these image attributes."""
    return _with(layout, lambda entry: None if entry.attribute in attributes else entry)


def _with(layout: PdoLayout, change: Callable[[Entry], Entry | None]) -> PdoLayout:
    """The layout with other objects; None: without an object, and without a PDO that has none left."""

    def changed(pdos: Sequence[Pdo]) -> tuple[Pdo, ...]:
        kept = ((item, tuple(filter(None, map(change, item.entries)))) for item in pdos)
        return tuple(Pdo(item.direction, item.number, entries) for item, entries in kept if entries)

    return replace(layout, rpdos=changed(layout.rpdos), tpdos=changed(layout.tpdos))
