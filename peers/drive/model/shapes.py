"""Variants of simulated drives, and the machines that they move, with the limits of their travel.

``shapes.toml`` declares the variants: the ENGEL-like drive with other objects, units, modes, PDOs and behaviour. The motor is
always the same, with 4096 increments a revolution. The meaning of a value depends on the variant.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from types import MappingProxyType
from typing import Any, Final

from pydantic import TypeAdapter

from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.communication import GUARD_TIME, LIFE_TIME_FACTOR, SYNC_PERIOD, communication_objects, pdo_objects
from pdgw.ds301.eds.writer import DeviceInfo
from pdgw.ds301.objects import Access, CanType, ObjectAddress, ObjectSpec, var
from pdgw.ds301.pdo import Pdo, PdoDirection
from pdgw.dsp402.drive import touch_probe
from pdgw.dsp402.identification.overlay import Address
from pdgw.dsp402.modes import SUPPORTED_MODES, Mode
from pdgw.dsp402.objects import DRIVE_OBJECTS, FURTHER_OBJECTS, SI_UNIT_VELOCITY, SUPPORTED_DRIVE_MODES
from pdgw.dsp402.objects import NEGATIVE_LIMIT_SWITCH as NEGATIVE_LIMIT
from pdgw.dsp402.objects import POSITIVE_LIMIT_SWITCH as POSITIVE_LIMIT
from pdgw.dsp402.pdo.layouts import pdo
from pdgw.peers import option_values
from pdgw.peers.drive.objects import DRIVE_TYPE, FAMILY, FAMILY_MODES, INFO, OBJECTS, REVISION, VALUES, drive_objects
from pdgw.peers.drive.option_codes import OPTION_CODES, limits

POSITIONS = ("touch_probe_1_rising", "touch_probe_1_falling", "touch_probe_2_rising", "touch_probe_2_falling")
"""Attributes of the image, by edge of the touch probe."""
_I32, _U8, _U16, _U32 = CanType.I32, CanType.U8, CanType.U16, CanType.U32
_RO, _RW = Access.RO, Access.RW
_VENDOR_ID = 0x0000_0FFF
"""An unused vendor ID: no overlay matches the device."""
_MANUFACTURER = frozenset({0x6094, *(entry.index for entry in FAMILY.entries.values())})
_RATED_RPM = 3000
_MAX_RPM_S = 10_000
_PROFILE_RPM_S = 3000
_ENGEL_MODES = frozenset({*FAMILY_MODES, Mode.POSITION, Mode.VELOCITY, Mode.TORQUE, Mode.HOMING})
_RPM_MODES = frozenset({Mode.POSITION.value, Mode.VELOCITY.value, Mode.HOMING.value})
_OPTION_CODES: Final = {(index, 0): VALUES[index, 0].default for index in OPTION_CODES}
_RPM: Final = 0x00B4_4700


def _with_limits(spec: ObjectSpec) -> ObjectSpec:
    if spec.index not in OPTION_CODES:
        return spec
    low, high = limits(spec.index)
    return replace(spec, entries=tuple(replace(entry, low=low, high=high) for entry in spec.entries))


_CATALOGUE: Final = (
    var(SYNC_PERIOD, "Communication cycle period", _U32, _RW, unit="us"),
    var(GUARD_TIME, "Guard time", _U16, _RW, unit="ms"),
    var(LIFE_TIME_FACTOR, "Life time factor", _U8, _RW),
    *map(_with_limits, DRIVE_OBJECTS.objects),
    *FURTHER_OBJECTS,
    var(touch_probe.FUNCTION, "Touch probe function", _U16, _RW, pdo=True, attribute="touch_probe_function"),
    var(touch_probe.STATUS, "Touch probe status", _U16, _RO, pdo=True, attribute="touch_probe_status"),
    *(
        var(index, f"Touch probe position {edge}", _I32, _RO, pdo=True, attribute=attribute)
        for edge, (index, attribute) in enumerate(zip(touch_probe.POSITIONS, POSITIONS, strict=True), 1)
    ),
)
"""The objects that a variant may have."""


@dataclass(frozen=True, slots=True)
class Shape:
    """A variant of the simulated drive."""

    name: str
    text: str
    """For the help of ``pdgw sim drive --like``."""
    velocity_per_rpm: Fraction | None = None
    """Velocity units per rpm; None: from 6094h."""
    acceleration_per_rpm_s: Fraction = Fraction(1, 10)
    modes: frozenset[int] = _ENGEL_MODES
    lacks: frozenset[int] = frozenset()
    """Objects of the ENGEL-like drive that it lacks."""
    has: tuple[ObjectSpec, ...] = ()
    """Objects in addition to those of the ENGEL-like drive, or instead of them."""
    pdos: int = 5
    event_timer: bool = True
    time_out: bool = False
    """Its RPDOs have a timeout (1400h/5)."""
    fixed_pdos: tuple[Pdo, ...] = ()
    """Its PDOs, if their mapping cannot be written."""
    habits: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    """What it does from power-on, by the names of ``peers.habits``, with the parameters."""
    wraps: bool = False
    """Its position overflows at the end of 607Bh, whose last value equals the first. Otherwise 607Bh limits the targets."""
    sync_tolerance: int = 3
    """Periods (1006h) without SYNC that are a fault in a cyclic synchronous mode."""
    node_guarding: bool = False
    """It monitors its master by node guarding instead of heartbeats."""
    info: DeviceInfo = field(default=INFO)

    def objects(self, serial_number: int = 1, pdos: int | None = None) -> tuple[ObjectSpec, ...]:
        """Every object of the drive. ``pdos``: number of RPDOs and TPDOs, if it differs from the variant's."""
        number = self.pdos if pdos is None else pdos
        if self.name == option_values.ENGEL:
            return drive_objects(serial_number, number)
        info = self.info
        identity = (info.vendor_id, info.product_code, info.revision, serial_number)
        mapped = self.fixed_pdos or (pdo(PdoDirection.RPDO, 1, "controlword"), pdo(PdoDirection.TPDO, 1, "statusword"))
        of_pdos: Iterable[ObjectSpec] = pdo_objects(
            number, number, mapped, event_timer=self.event_timer, time_out=self.time_out
        )
        if self.fixed_pdos:
            of_pdos = map(_fixed, of_pdos)
        own = {spec.index: spec for spec in self.has}
        everything = (
            *communication_objects(DRIVE_TYPE, info.product_name, identity, ("1.0", "1.0")),
            *of_pdos,
            *OBJECTS.objects,
        )
        kept = [spec for spec in everything if spec.index not in self.lacks and spec.index not in own]
        return (*kept, *own.values())


def _fixed(spec: ObjectSpec) -> ObjectSpec:
    """A PDO whose identifier and mapping cannot be written."""
    mapping = any(item.mapping_index <= spec.index < item.mapping_index + 8 for item in PdoDirection)
    entries = tuple(replace(entry, access=_RO) if mapping or entry.subindex == 1 else entry for entry in spec.entries)
    return replace(spec, entries=entries)


_R, _T = PdoDirection.RPDO, PdoDirection.TPDO
_PREDEFINED = (
    pdo(_R, 1, "controlword"),
    pdo(_R, 2, "controlword", "modes_of_operation"),
    pdo(_R, 3, "controlword", "target_position"),
    pdo(_R, 4, "controlword", "target_velocity"),
    pdo(_T, 1, "statusword"),
    pdo(_T, 2, "statusword", "modes_of_operation_display"),
    pdo(_T, 3, "statusword", "position_actual"),
    pdo(_T, 4, "statusword", "velocity_actual"),
)
"""The PDOs that CiA 402 predefines."""


def objects_with(values: Mapping[ObjectAddress, int], lacks: frozenset[int] = frozenset()) -> tuple[ObjectSpec, ...]:
    """The objects of the profile that have values after power-on, without those that ``lacks`` lists."""
    indices = {index for index, _ in values} - lacks
    return tuple(
        replace(
            spec, entries=tuple(replace(item, default=values.get(item.address, item.default)) for item in spec.entries)
        )
        for spec in _CATALOGUE
        if spec.index in indices
    )


def _values(velocity: Fraction, acceleration: Fraction, modes: frozenset[int]) -> dict[ObjectAddress, int]:
    """Speeds and ramps in these units per rpm and per rpm/s, and the supported modes."""
    speed = int(_RATED_RPM * velocity)
    rate, most = int(_PROFILE_RPM_S * acceleration), int(_MAX_RPM_S * acceleration)
    return {
        (0x6081, 0): speed // 3,
        (0x6083, 0): rate,
        (0x6084, 0): rate,
        (0x6085, 0): most,
        (0x6099, 1): int(200 * velocity),
        (0x6099, 2): int(50 * velocity),
        (0x609A, 0): rate,
        (0x60FF, 0): 0,
        (0x607F, 0): speed,
        (0x60C5, 0): most,
        (0x60C6, 0): most,
        (SUPPORTED_DRIVE_MODES, 0): sum(1 << bit for bit, mode in SUPPORTED_MODES.items() if mode in modes),
    }


addresses = TypeAdapter(dict[Address, int]).validate_python
"""Values by objects, from keys like ``607Bh/1``."""
_indices = TypeAdapter(frozenset[Address]).validate_python


def _shape(name: str, keys: dict[str, Any]) -> Shape:
    """A table of ``shapes.toml``."""
    values = addresses(keys.pop("values", {}))
    lacks = frozenset(index for index, _ in _indices(keys.pop("lacks", ())))
    for key in keys.keys() & {"velocity_per_rpm", "acceleration_per_rpm_s"}:
        keys[key] = Fraction(keys[key])
    if "modes" in keys:
        keys["modes"] = frozenset(keys["modes"])
    if keys.pop("fixed_pdos", False):
        keys["fixed_pdos"] = _PREDEFINED
    unmappable = {index for index, _ in _indices(keys.pop("unmappable", ()))}
    product_code = keys.pop("rpm", None)
    if product_code is not None:
        if "velocity_per_rpm" not in keys:
            values = {(SI_UNIT_VELOCITY, 0): _RPM} | values
        in_rpm = {
            "velocity_per_rpm": Fraction(1),
            "acceleration_per_rpm_s": Fraction(1),
            "modes": _RPM_MODES,
            "wraps": True,
        }
        keys = {**in_rpm, **keys}
        units = keys["velocity_per_rpm"], keys["acceleration_per_rpm_s"]
        values = _OPTION_CODES | _values(*units, keys["modes"]) | values
        keys["info"] = DeviceInfo("Nobody", f"Simulated drive {name}", _VENDOR_ID, product_code, REVISION)
        lacks |= _MANUFACTURER
    has = {spec.index: spec for spec in objects_with(values, lacks)}
    for spec in _CATALOGUE:
        if spec.index in unmappable:
            entries = tuple(replace(entry, pdo=False) for entry in has.get(spec.index, spec).entries)
            has[spec.index] = replace(spec, entries=entries)
    return Shape(name, has=tuple(has.values()), lacks=lacks, **keys)


_TABLES = tomllib.loads(option_values.SHAPES_FILE.read_text(encoding="utf-8"))
SHAPES: Mapping[str, Shape] = MappingProxyType({name: _shape(name, keys) for name, keys in _TABLES.items()})
"""Every variant by name."""
ENGEL = SHAPES[option_values.ENGEL]
SYNCHRONOUS = SHAPES[option_values.SYNCHRONOUS]
ENDLESS = SHAPES["endless"]


def shape(name: str) -> Shape:
    """The variant with a name; CanopenError lists the known names."""
    try:
        return SHAPES[name]
    except KeyError:
        raise CanopenError("shape of drive", name, ", ".join(SHAPES)) from None


@dataclass(frozen=True, slots=True)
class Machine:
    """Limits of the simulated axis in increments of the machine (power-on position is 0). A shaft has none."""

    negative_limit: float | None = None
    positive_limit: float | None = None
    negative_stop: float = -math.inf
    positive_stop: float = math.inf

    def stop(self, direction: float) -> float:
        """The mechanical stop in a direction."""
        return self.negative_stop if direction < 0 else self.positive_stop

    def within_stops(self, position: float) -> bool:
        """Whether the position is between the mechanical stops."""
        return self.negative_stop < position < self.positive_stop

    def switches(self, position: float) -> int:
        """The limit switches of 60FDh at a position."""
        inputs = 0
        if self.negative_limit is not None and position <= self.negative_limit:
            inputs |= NEGATIVE_LIMIT
        if self.positive_limit is not None and position >= self.positive_limit:
            inputs |= POSITIVE_LIMIT
        return inputs


ROTARY_AXIS = Machine()
LINEAR_AXIS = Machine(-550_000, 550_000, -600_000, 600_000)
"""A slide with limit switches 134 revolutions away on either side, and mechanical stops beyond them."""
MACHINES = {"rotary": ROTARY_AXIS, "linear": LINEAR_AXIS}
