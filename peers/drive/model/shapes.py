"""Variants of simulated drives: the ENGEL-like drive with other objects, units, modes, PDOs and behaviour.

Each variant is one difference between drives on the market, which CiA 402 permits. The motor is always the same, with 4096
increments a revolution. The meaning of a value depends on the variant.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from fractions import Fraction
from types import MappingProxyType

from pdgw.ds301.communication import (
    CONSUMER_HEARTBEAT,
    GUARD_TIME,
    LIFE_TIME_FACTOR,
    PRODUCER_HEARTBEAT,
    SYNC_PERIOD,
    communication_objects,
    pdo_objects,
)
from pdgw.ds301.eds.writer import DeviceInfo
from pdgw.ds301.errors import CanopenError
from pdgw.ds301.objects import Access, CanType, Entry, ObjectSpec, array, var
from pdgw.ds301.pdo import Pdo, PdoDirection
from pdgw.dsp402.drive import touch_probe
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.pdo.layouts import pdo
from pdgw.durations import SECONDS_PER_MINUTE
from pdgw.peers import option_values
from pdgw.peers.drive.device import DRIVE_TYPE, INFO, OBJECTS, REVISION, drive_objects
from pdgw.peers.drive.family import FAMILY, FAMILY_MODES
from pdgw.peers.drive.model.motion import INCREMENTS_PER_REVOLUTION
from pdgw.peers.drive.model.probe import POSITIONS

_I16, _I32, _U8, _U16, _U32 = CanType.I16, CanType.I32, CanType.U8, CanType.U16, CanType.U32
_RO, _RW = Access.RO, Access.RW
_VENDOR_ID = 0x0000_0FFF
"""An unused vendor ID: no overlay matches the device."""
_MANUFACTURER = frozenset({0x6094, *(entry.index for entry in FAMILY.entries.values())})
_PROFILE_MODES = 1 << 0 | 1 << 2 | 1 << 5
"""6502h: profile position, profile velocity, homing."""
_RATED_RPM = 3000
_MAX_RPM_S = 10_000
_PROFILE_RPM_S = 3000
_SLOW_BOOT_MS = 15_000
_SLOW_SDO_MS = 500
_ENGEL_MODES = frozenset({*FAMILY_MODES, Mode.POSITION, Mode.VELOCITY, Mode.TORQUE, Mode.HOMING})


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
    boot_ms: int = 0
    sdo_ms: int = 0
    """Delay of each SDO answer in milliseconds."""
    fault_reset_edges: int = 1
    """Number of rising edges of Controlword 7 that reset a fault."""
    starts_in_fault: bool = False
    mode_in_operation_only: bool = False
    """6061h is 0 except in operation."""
    frozen: frozenset[str] = frozenset()
    """Objects accepted in the mapping of a TPDO but sent as zeros."""
    wraps: bool = False
    """Its position overflows at the end of 607Bh, whose last value equals the first. Targets are within this range."""
    sync_tolerance: int = 3
    """Periods (1006h) without SYNC that are a fault in a cyclic synchronous mode."""
    node_guarding: bool = False
    """It monitors its master by node guarding instead of heartbeats."""
    info: DeviceInfo = field(default=INFO)

    def objects(self, serial_number: int = 1, pdos: int | None = None) -> tuple[ObjectSpec, ...]:
        """Every object of the drive. ``pdos``: number of RPDOs and TPDOs, if it differs from the variant's."""
        number = self.pdos if pdos is None else pdos
        if self.name == ENGEL.name:
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


def _ratio(index: int, name: str, numerator: int, denominator: int) -> ObjectSpec:
    return array(
        index,
        name,
        Entry(index, 1, "Numerator", _U32, _RW, default=numerator),
        Entry(index, 2, "Denominator", _U32, _RW, default=denominator),
    )


def _kinematics(velocity: Fraction, acceleration: Fraction, *, limits: bool = True) -> tuple[ObjectSpec, ...]:
    """The objects with velocities and accelerations, in these units per rpm and per rpm/s."""
    speed = int(_RATED_RPM * velocity)
    fast, slow = int(200 * velocity), int(50 * velocity)
    rate, most = int(_PROFILE_RPM_S * acceleration), int(_MAX_RPM_S * acceleration)
    objects = (
        var(0x6081, "Profile velocity", _U32, _RW, pdo=True, default=speed // 3, attribute="profile_velocity"),
        var(0x6083, "Profile acceleration", _U32, _RW, pdo=True, default=rate, attribute="profile_acceleration"),
        var(0x6084, "Profile deceleration", _U32, _RW, pdo=True, default=rate, attribute="profile_deceleration"),
        var(0x6085, "Quick stop deceleration", _U32, _RW, default=most),
        array(
            0x6099,
            "Homing speeds",
            Entry(0x6099, 1, "Speed during search for switch", _U32, _RW, default=fast),
            Entry(0x6099, 2, "Speed during search for zero", _U32, _RW, default=slow),
        ),
        var(0x609A, "Homing acceleration", _U32, _RW, default=rate),
        var(0x60FF, "Target velocity", _I32, _RW, pdo=True, default=0, attribute="target_velocity"),
    )
    if not limits:
        return objects
    return (
        *objects,
        var(0x607F, "Max profile velocity", _U32, _RW, default=speed),
        var(0x60C5, "Max acceleration", _U32, _RW, default=most),
        var(0x60C6, "Max deceleration", _U32, _RW, default=most),
    )


_PER_SECOND = Fraction(INCREMENTS_PER_REVOLUTION, SECONDS_PER_MINUTE)
"""Increments per second of one rpm."""
_RPM_OBJECTS = (
    *_kinematics(Fraction(1), Fraction(1)),
    var(0x60A9, "SI unit velocity", _U32, _RW, default=0x00B4_4700),
    var(0x6502, "Supported drive modes", _U32, _RO, default=_PROFILE_MODES),
)
_RPM_MODES = frozenset({Mode.POSITION.value, Mode.VELOCITY.value, Mode.HOMING.value})


def _info(name: str, product_code: int) -> DeviceInfo:
    return DeviceInfo("Nobody", f"Simulated drive {name}", _VENDOR_ID, product_code, REVISION)


def _rpm(name: str, text: str, product_code: int) -> Shape:
    """A plain drive in rpm; other variants differ from it in one property."""
    return Shape(
        name,
        text,
        velocity_per_rpm=Fraction(1),
        acceleration_per_rpm_s=Fraction(1),
        modes=_RPM_MODES,
        lacks=_MANUFACTURER,
        has=_RPM_OBJECTS,
        info=_info(name, product_code),
    )


def _with(shape: Shape, *objects: ObjectSpec) -> tuple[ObjectSpec, ...]:
    """The variant's objects with others added or replaced."""
    own = {spec.index for spec in objects}
    return (*(spec for spec in shape.has if spec.index not in own), *objects)


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
_VL_LACKS = frozenset(
    {0x606B, 0x606C, 0x606D, 0x606F, 0x607A, 0x607B, 0x607C, 0x607F, 0x6081, 0x6083, 0x6084, 0x6085, 0x6086}
    | {0x6098, 0x6099, 0x609A, 0x60C5, 0x60C6, 0x60FF}
)
_PROFILES = frozenset({0x6081, 0x6083, 0x6084, 0x6086, 0x60FF})
"""Objects that only profile position and profile velocity use."""
_VL_OBJECTS = (
    var(0x6042, "vl target velocity", _I16, _RW, pdo=True, default=0, attribute="target_velocity"),
    var(0x6043, "vl velocity demand", _I16, _RO, pdo=True, default=0, attribute="velocity_demand"),
    var(0x6044, "vl velocity actual value", _I16, _RO, pdo=True, default=0, attribute="velocity_actual"),
    _ratio(0x6046, "vl velocity min max amount", 0, _RATED_RPM),
    _ratio(0x6048, "vl velocity acceleration", _PROFILE_RPM_S, 1),
    _ratio(0x6049, "vl velocity deceleration", _PROFILE_RPM_S, 1),
    var(0x6502, "Supported drive modes", _U32, _RO, default=1 << 1),
)

ENGEL = Shape(option_values.ENGEL, "the ENGEL-like drive: half rpm by 6094h, five PDOs, modes -5 to 6")
_TOUCH_PROBE = (
    var(touch_probe.FUNCTION, "Touch probe function", _U16, _RW, pdo=True, default=0, attribute="touch_probe_function"),
    var(touch_probe.STATUS, "Touch probe status", _U16, _RO, pdo=True, default=0, attribute="touch_probe_status"),
    *(
        var(index, f"Touch probe position {edge}", _I32, _RO, pdo=True, default=0, attribute=attribute)
        for edge, (index, attribute) in enumerate(zip(touch_probe.POSITIONS, POSITIONS, strict=True), 1)
    ),
)
SYNCHRONOUS = Shape(
    option_values.SYNCHRONOUS,
    "the ENGEL-like drive with cyclic synchronous position, velocity and torque, and a touch probe",
    modes=_ENGEL_MODES | {Mode.CYCLIC_POSITION.value, Mode.CYCLIC_VELOCITY.value, Mode.CYCLIC_TORQUE.value},
    has=(
        *_TOUCH_PROBE,
        var(SYNC_PERIOD, "Communication cycle period", _U32, _RW, default=0, unit="us"),
        var(0x6502, "Supported drive modes", _U32, _RO, default=_PROFILE_MODES | 1 << 7 | 1 << 8 | 1 << 9),
    ),
)
_PLAIN = _rpm("rpm", "rpm by 60A9h", 1)
_COUNTS = _rpm("counts", "increments per second by 608Fh", 2)

SHAPES = MappingProxyType(
    {
        shape.name: shape
        for shape in (
            ENGEL,
            SYNCHRONOUS,
            _PLAIN,
            replace(
                _COUNTS,
                velocity_per_rpm=_PER_SECOND,
                acceleration_per_rpm_s=_PER_SECOND,
                has=(
                    *_kinematics(_PER_SECOND, _PER_SECOND),
                    _ratio(0x608F, "Position encoder resolution", INCREMENTS_PER_REVOLUTION, 1),
                    var(0x6502, "Supported drive modes", _U32, _RO, default=_PROFILE_MODES),
                ),
            ),
            replace(
                _rpm("si", "0.1 rpm by 60A9h, increments by 60A8h and 608Fh", 3),
                velocity_per_rpm=Fraction(10),
                has=(
                    *_kinematics(Fraction(10), Fraction(1)),
                    var(0x60A8, "SI unit position", _U32, _RW, default=0x00B5_0000),
                    var(0x60A9, "SI unit velocity", _U32, _RW, default=0xFFB4_4700),
                    _ratio(0x608F, "Position encoder resolution", INCREMENTS_PER_REVOLUTION, 1),
                    var(0x6502, "Supported drive modes", _U32, _RO, default=_PROFILE_MODES),
                ),
            ),
            replace(
                _rpm("fixed-pdo", "rpm; the predefined PDOs of CiA 402, which cannot be mapped", 4),
                pdos=4,
                fixed_pdos=_PREDEFINED,
            ),
            replace(_rpm("no-event-timer", "rpm; TPDOs without event timer (1800h/5)", 5), event_timer=False),
            replace(
                _rpm("vl", "velocity mode only (6042h, rpm), like frequency converters", 6),
                modes=frozenset({Mode.VL_VELOCITY.value}),
                lacks=_MANUFACTURER | _VL_LACKS,
                has=_VL_OBJECTS,
            ),
            replace(
                _rpm("csv", "cyclic synchronous velocity and homing only, increments per second", 7),
                velocity_per_rpm=_PER_SECOND,
                acceleration_per_rpm_s=_PER_SECOND,
                modes=frozenset({Mode.CYCLIC_VELOCITY.value, Mode.HOMING.value}),
                has=(
                    *_kinematics(_PER_SECOND, _PER_SECOND),
                    _ratio(0x608F, "Position encoder resolution", INCREMENTS_PER_REVOLUTION, 1),
                    var(0x6502, "Supported drive modes", _U32, _RO, default=1 << 8 | 1 << 5),
                ),
            ),
            replace(
                _rpm("csp", "cyclic synchronous position and homing only, increments per second", 20),
                velocity_per_rpm=_PER_SECOND,
                acceleration_per_rpm_s=_PER_SECOND,
                modes=frozenset({Mode.CYCLIC_POSITION.value, Mode.HOMING.value}),
                lacks=_MANUFACTURER | _PROFILES,
                has=(
                    *(spec for spec in _kinematics(_PER_SECOND, _PER_SECOND) if spec.index not in _PROFILES),
                    _ratio(0x608F, "Position encoder resolution", INCREMENTS_PER_REVOLUTION, 1),
                    var(0x60AA, "SI unit acceleration", _U32, _RW, default=0x00B5_0303),
                    var(SYNC_PERIOD, "Communication cycle period", _U32, _RW, default=0, unit="us"),
                    var(0x6502, "Supported drive modes", _U32, _RO, default=1 << 7 | 1 << 5),
                ),
            ),
            replace(
                _rpm("node-guarding", "rpm; node and life guarding (100Ch, 100Dh), no heartbeats", 8),
                lacks=_MANUFACTURER | {CONSUMER_HEARTBEAT, PRODUCER_HEARTBEAT},
                has=(
                    *_RPM_OBJECTS,
                    var(GUARD_TIME, "Guard time", _U16, _RW, default=0, unit="ms"),
                    var(LIFE_TIME_FACTOR, "Life time factor", _U8, _RW, default=0),
                ),
                node_guarding=True,
            ),
            replace(
                _rpm("rpdo-timeout", "rpm; monitors its master only by the timeout of its RPDOs (1400h/5)", 12),
                lacks=_MANUFACTURER | {CONSUMER_HEARTBEAT, PRODUCER_HEARTBEAT},
                time_out=True,
            ),
            replace(
                _rpm("unguarded", "rpm; does not monitor its master", 13),
                lacks=_MANUFACTURER | {CONSUMER_HEARTBEAT, PRODUCER_HEARTBEAT},
            ),
            replace(
                _rpm("no-abort-option", "rpm; heartbeats without 6007h: a lost master is a malfunction", 14),
                lacks=_MANUFACTURER | {0x6007},
            ),
            replace(_rpm("mode-late", "rpm; 6061h shows the mode only in operation", 15), mode_in_operation_only=True),
            replace(
                _rpm("frozen", "rpm; accepts 606Ch in a TPDO but sends 0", 16),
                frozen=frozenset({"velocity_actual"}),
            ),
            replace(
                _rpm("two-edges", "rpm; powers up in Fault, which two edges of Controlword 7 reset", 18),
                starts_in_fault=True,
                fault_reset_edges=2,
            ),
            replace(
                _rpm("stays-stopped", "rpm; stays in Quick Stop Active at standstill (605Ah = 6)", 19),
                has=(*_RPM_OBJECTS, var(0x605A, "Quick stop option code", _I16, _RW, default=6)),
            ),
            replace(_rpm("slow-sdo", "rpm; answers SDO after half a second", 17), sdo_ms=_SLOW_SDO_MS),
            replace(_rpm("four-pdo", "rpm; four PDOs of each direction", 9), pdos=4),
            replace(
                _rpm("no-range", "rpm; 607Bh is 0/0, 60C5h and 60C6h are missing", 10),
                lacks=_MANUFACTURER | {0x60C5, 0x60C6},
                has=_with(
                    replace(_PLAIN, has=(*_kinematics(Fraction(1), Fraction(1), limits=False), *_RPM_OBJECTS[-2:])),
                    array(
                        0x607B,
                        "Position range limit",
                        Entry(0x607B, 1, "Minimum", _I32, _RW, default=0),
                        Entry(0x607B, 2, "Maximum", _I32, _RW, default=0),
                    ),
                ),
            ),
            replace(_rpm("slow-boot", "rpm; boots 15 s after power-on", 11), boot_ms=_SLOW_BOOT_MS),
        )
    }
)
"""Every variant by name."""


def shape(name: str) -> Shape:
    """The variant with a name; CanopenError lists the known names."""
    try:
        return SHAPES[name]
    except KeyError:
        raise CanopenError("shape of drive", name, ", ".join(SHAPES)) from None
