"""Drives of the market as their data sheets show them: which objects they have, which of these a PDO can carry, their PDOs.

The first thirteen follow the makers' public EDS and DCF files, the last three the makers' manuals (unverified). Objects that the
gateway does not use are left out. What turns is the simulator's motor with 4096 increments a revolution.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cache

from pdgw.ds301.communication import CONSUMER_HEARTBEAT, GUARD_TIME, LIFE_TIME_FACTOR, PRODUCER_HEARTBEAT, SYNC_PERIOD
from pdgw.ds301.eds.writer import DeviceInfo, write_eds
from pdgw.ds301.objects import Access, CanType, Entry, ObjectSpec, var
from pdgw.ds301.pdo import Pdo, PdoDirection
from pdgw.dsp402.identification.generic import generic_objects
from pdgw.dsp402.modes import SUPPORTED_MODES
from pdgw.dsp402.pdo.layouts import pdo
from pdgw.peers.drive.device import OBJECTS, REVISION
from pdgw.peers.drive.model.shapes import Shape

COUNTS = Fraction(4096, 60)
"""Increments per second of one rpm."""
_NO_LIMIT = 0xFFFF_FFFF
_DEFAULTS = {
    **dict.fromkeys(((0x607F, 0), (0x6080, 0), (0x60C5, 0), (0x60C6, 0)), _NO_LIMIT),
    **{(index, sub): 1 for index in (0x604C, 0x608F, *range(0x6090, 0x6098)) for sub in (1, 2)},
    **{(index, sub): value for index in (0x6048, 0x6049) for sub, value in ((1, 3000), (2, 1))},
    (0x6046, 2): 3000,
    (0x605A, 0): 2,
    (0x605E, 0): 2,
    (0x6060, 0): 1,
    (0x6061, 0): 1,
    (0x6072, 0): 1000,
    (0x60C2, 1): 1,
    (0x60C2, 2): -3,
}
"""What a drive holds where its sheet gives no default: no limit, factors of 1."""
_RAMP = 10_000
"""rpm/s, of the drive as it is delivered."""


@dataclass(frozen=True)
class Sheet:
    """One data sheet, and what the product has to make of it."""

    maker: str
    product: str
    vendor_id: int
    product_code: int
    objects: str
    """Indices in the profile's area."""
    unmappable: str = ""
    """Those of them that no PDO can carry, although the profile allows it."""
    defaults: Mapping[tuple[int, int], int] = field(default_factory=dict)
    modes: tuple[int, ...] = (1, 3, 6)
    pdos: int = 4
    fixed: bool = False
    """Controlword and Statusword in PDO 1, and no other mapping."""
    event_timer: bool = True
    life_guarding: bool = False
    """100Ch and 100Dh, no heartbeats."""
    velocity: Fraction = COUNTS
    """Velocity units of one rpm,"""
    ramp: Fraction = COUNTS
    """and acceleration units of one rpm/s."""
    units: tuple[str, str] = ("counts/s", "counts/s2")
    """velocity_unit and acceleration_unit."""
    refused: Mapping[int, str] = field(default_factory=dict)
    """Why a telegram is refused, by its number."""

    @property
    def name(self) -> str:
        return f"{self.maker} {self.product}"

    @property
    def keys(self) -> str:
        """What the product asks the user for."""
        velocity, acceleration = self.units
        return (
            f"rated_speed_rpm = 3000\nrated_acceleration_rpm_s = {_RAMP}\ncounts_per_revolution = 4096\n"
            f'velocity_unit = "{velocity}"\nacceleration_unit = "{acceleration}"\n'
        )

    @property
    def indices(self) -> frozenset[int]:
        return frozenset(int(index, 16) for index in self.objects.split())

    @property
    def shape(self) -> Shape:
        """The drive of the sheet."""
        return _shape(self.name)

    @property
    def eds(self) -> str:
        """The text of the data sheet."""
        return write_eds(self.shape.info, self.shape.objects())


@cache
def _shape(name: str) -> Shape:
    sheet = SHEETS[name]
    ramp = int(_RAMP * sheet.ramp)
    values = {
        **_DEFAULTS,
        **{(index, 0): ramp for index in (0x6083, 0x6084, 0x6085, 0x609A)},
        (0x6502, 0): sum(1 << bit for bit, mode in SUPPORTED_MODES.items() if mode.value in sheet.modes),
        **sheet.defaults,
    }
    has = [_object(spec, values, sheet.unmappable) for spec in generic_objects() if spec.index in sheet.indices]
    missing = {SYNC_PERIOD}
    if sheet.life_guarding:
        missing |= {CONSUMER_HEARTBEAT, PRODUCER_HEARTBEAT}
        has.append(var(GUARD_TIME, "Guard time", CanType.U16, Access.RW, default=0))
        has.append(var(LIFE_TIME_FACTOR, "Life time factor", CanType.U8, Access.RW, default=0))
    words = (pdo(PdoDirection.RPDO, 1, "controlword"), pdo(PdoDirection.TPDO, 1, "statusword"))
    fixed: tuple[Pdo, ...] = words if sheet.fixed else ()
    return Shape(
        name,
        name,
        velocity_per_rpm=sheet.velocity,
        acceleration_per_rpm_s=sheet.ramp,
        modes=frozenset(mode for mode in sheet.modes if mode in {1, 2, 3, 6, 8, 9}),
        lacks=frozenset({spec.index for spec in OBJECTS.objects} - sheet.indices | missing),
        has=tuple(has),
        pdos=sheet.pdos,
        fixed_pdos=fixed,
        event_timer=sheet.event_timer,
        node_guarding=sheet.life_guarding,
        info=DeviceInfo(sheet.maker, sheet.product, sheet.vendor_id, sheet.product_code, REVISION),
    )


def _object(spec: ObjectSpec, values: Mapping[tuple[int, int], int], unmappable: str) -> ObjectSpec:
    carried = f"{spec.index:04X}" not in unmappable

    def own(entry: Entry) -> Entry:
        value = entry.default if entry.default is not None else values.get(entry.address, 0)
        return replace(entry, pdo=entry.pdo and carried, default=values.get(entry.address, value), low=None, high=None)

    return replace(spec, entries=tuple(map(own, spec.entries)))


_RPM = {"velocity": Fraction(1), "ramp": Fraction(1), "units": ("rpm", "rpm/s")}
_VL_UNIT = "the unit of 6042h differs from the unit of 6081h"
_NO_TASKS = {9: _VL_UNIT, 111: _VL_UNIT}
_WORDS = "6040 6041 6060 6061 6064"
_HOMING = "6098 6099 609A"
_FAULHABER = f"{_WORDS} 6067 606B 606C 606D 606F 607A 607C 607F 6081 6083 6084 6085 {_HOMING} 60FF"
_CF = f"{_FAULHABER} 6086 608F 6093 6096 6097"
_NOT_IN_CF = "6060 6061 6064 606B 606C 607A 6081 6083 6084 60FF"
_TRINAMIC = (
    f"{_WORDS} 605A 605B 605C 605D 605E 6065 6067 606C 607A 607C 6081 6083 6084 6085 608F {_HOMING} 60B1 60C2 60FD 60FF "
    "6502"
)
_ELMO = (
    f"6007 603F {_WORDS} 605A 605B 605C 605D 605E 6065 6067 606B 606C 606D 606F 6071 6072 6073 6075 6078 607A 607B 607C 607F "
    f"6080 6081 6083 6084 6085 6086 608F 6090 6096 6097 {_HOMING} 60C2 60FD 60FF 6502"
)
_SCHUNK = (
    "6040 6041 6042 6043 6044 6046 6048 6049 604C 6060 6061 6064 6065 606B 606C 6073 6075 607A 607C 6081 6083 6086 6098 60C2 "
    "60FD 60FE 6502"
)

SHEETS: Mapping[str, Sheet] = {
    sheet.name: sheet
    for sheet in (
        Sheet(
            "maxon",
            "EPOS2 50/5",
            0xFB,
            0x6322_0000,
            f"6007 {_WORDS} 605B 605C 605E 6065 6067 606B 606C 606D 6078 607A 607C 607F 6081 6083 6084 6085 6086 6089 608A 608B "
            f"608C 608D 608E {_HOMING} 60C2 60C5 60FF 6502",
            defaults={(0x607F, 0): 25_000, (0x608A, 0): 172, (0x608C, 0): 164, (0x608E, 0): 164},
            event_timer=False,
            **_RPM,  # type: ignore[arg-type]
        ),
        Sheet(
            "maxon",
            "EPOS4 Module 50/15",
            0xFB,
            0x6552_0000,
            f"6007 603F {_WORDS} 605A 605B 605C 605E 6065 6067 606B 606C 6071 607A 607B 607F 6080 6081 6083 6084 6085 6086 "
            f"{_HOMING} 60A8 60A9 60AA 60B1 60C2 60C5 60FD 60FE 60FF 6502",
            defaults={(0x607F, 0): 50_000, (0x6080, 0): 50_000, (0x60A9, 0): 0xB4_4700, (0x60AA, 0): 0xC0_0300},
            modes=(1, 3, 4, 6),
            event_timer=False,
            **_RPM,  # type: ignore[arg-type]
        ),
        Sheet(
            "Faulhaber",
            "MCBL CF",
            0x147,
            0,
            _CF,
            _NOT_IN_CF,
            {(0x607F, 0): 30_000},
            pdos=3,
            fixed=True,
            event_timer=False,
            life_guarding=True,
            **_RPM,  # type: ignore[arg-type]
        ),
        Sheet(
            "Faulhaber",
            "MCLM CF",
            0x147,
            0,
            _CF,
            _NOT_IN_CF,
            {(0x607F, 0): 60_000},
            pdos=3,
            fixed=True,
            event_timer=False,
            life_guarding=True,
            velocity=Fraction(18, 60),
            ramp=Fraction(18, 60),
            units=("1/18 rev/s", "1/18 rev/s2"),
        ),
        Sheet(
            "Faulhaber",
            "MCBL CO",
            0x147,
            0xC4E,
            f"{_FAULHABER} 6078 607B 608F 6091 6092 6093 60FD 6502",
            defaults={(0x607F, 0): 30_000, (0x607B, 1): -1_800_000_000, (0x607B, 2): 1_800_000_000},
            event_timer=False,
            **_RPM,  # type: ignore[arg-type]
        ),
        Sheet("Trinamic", "TMCM-1230", 0x286, 0x4CE, f"{_TRINAMIC} 6086", modes=(1, 3, 6, 8, 9)),
        Sheet("Trinamic", "TMCM-1270", 0x286, 0x4F6, _TRINAMIC, "6081 6083 6084 60B1", modes=(1, 3, 6, 8)),
        Sheet(
            "Technosoft",
            "iPOS",
            0x1A3,
            0,
            f"6007 {_WORDS} 605A 605B 605C 605D 605E 6065 6067 606B 606C 606F 6071 607A 607B 607C 6081 6083 6085 6086 6089 608A "
            f"608B 608C 608D 608E 6093 6094 6097 {_HOMING} 60C2 60FD 60FE 60FF 6502",
            life_guarding=True,
            velocity=COUNTS * Fraction(8192, 125),
            ramp=COUNTS * Fraction(1024, 15_625),
            units=("125/8192 counts/s", "15625/1024 counts/s2"),
        ),
        Sheet(
            "Elmo",
            "Gold Drive",
            0x9A,
            0x3_0923,
            f"{_ELMO} 6079 608C 608E 6091 6092 60B1 60C5 60C6 60E4 60FE",
            "603F 6072 6079",
            {(0x607F, 0): 2_000_000_000, (0x607B, 1): -1_000_000_000, (0x607B, 2): 1_000_000_000, (0x6072, 0): 50_000},
            modes=(1, 3, 4, 6),
        ),
        Sheet(
            "Elmo",
            "SimplIQ",
            0x9A,
            0,
            f"{_ELMO} 6089 608A 608B 608C 608D 608E 6093 6094",
            "603F 6061 6072",
            modes=(1, 3, 4, 6),
        ),
        Sheet("SCHUNK", "LWA", 0, 0, _SCHUNK, "60FE", modes=(1, 2), **_RPM, refused=_NO_TASKS),  # type: ignore[arg-type]
        Sheet("Pilz", "PRBT", 0, 0, _SCHUNK, "60FE", modes=(1, 2), **_RPM, refused=_NO_TASKS),  # type: ignore[arg-type]
        Sheet(
            "Yiyou",
            "EuServo",
            0x668,
            0x22_0811,
            f"603F {_WORDS} 605A 605B 605C 605D 605E 6065 6067 606B 606C 606D 606F 6071 6072 6079 607A 607C 607F 6081 6083 6084 "
            "6085 6091 60C2 60FF 6502",
            defaults={(0x607F, 0): 4_369_066, (0x6091, 1): 5_308_416, (0x6091, 2): 5_308_416},
            modes=(1, 3, 4, 8, 9),
        ),
        # RGM CAN-BUS Communication, edition A 2017; AKD CAN-BUS Communication, edition H 2012; CANopen Reference Manual V2.4.
        Sheet(
            "Kollmorgen",
            "RGM",
            0x6A,
            0x2020,
            f"6007 {_WORDS} 605A 605B 605C 605D 605E 6065 6067 606B 606C 6071 607A 607C 607D 6081 6083 6084 6085 6086 {_HOMING} "
            "60B1 60C2 60FF 6502",
            modes=(1, 3, 4, 6),
            pdos=4,
            velocity=COUNTS * 10,
            ramp=COUNTS / 10,
            units=("0.1 counts/s", "10 counts/s2"),
        ),
        Sheet(
            "Kollmorgen",
            "AKD",
            0x6A,
            0x0000,
            f"603F {_WORDS} 605A 6065 606B 606C 6071 6072 6073 607A 607C 6081 6083 6084 6085 608F 6091 6092 {_HOMING} 60B1 60C2 "
            "60FD 60FE 60FF 6502",
            modes=(1, 3, 6),
            velocity=Fraction(1000),
            ramp=Fraction(1),
            units=("0.001 rpm", "rpm/s"),
        ),
        Sheet(
            "Nanotec",
            "PD4-N",
            0x26C,
            0,
            f"{_WORDS} 605A 605B 605C 605D 605E 6042 6043 6044 6046 6048 6049 604C 6067 607A 607B 607C 607D 6081 6083 6084 "
            f"6085 6086 608F 6091 6092 {_HOMING} 60C2 60C5 60C6 60FD 60FE 6502",
            modes=(1, 2, 6),
            refused=_NO_TASKS,
            **_RPM,  # type: ignore[arg-type]
        ),
    )
}
"""By maker and product."""
