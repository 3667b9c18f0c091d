"""Drives of the market as their data sheets in ``data_sheets.toml`` show them.

What turns is the simulator's motor with 4096 increments a revolution.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

from pdgw.ds301.communication import CONSUMER_HEARTBEAT, GUARD_TIME, LIFE_TIME_FACTOR, PRODUCER_HEARTBEAT, SYNC_PERIOD
from pdgw.ds301.eds.writer import DeviceInfo, write_eds
from pdgw.ds301.objects import Access, CanType, Entry, ObjectSpec, var
from pdgw.ds301.pdo import Pdo, PdoDirection
from pdgw.dsp402.identification.generic import generic_objects
from pdgw.dsp402.modes import SUPPORTED_MODES
from pdgw.dsp402.pdo.layouts import pdo
from pdgw.peers.drive.model.shapes import Shape, addresses
from pdgw.peers.drive.objects import OBJECTS, REVISION

_COUNTS, _REVOLUTIONS = Fraction(4096, 60), Fraction(1, 60)
_BASES = {
    "rpm": Fraction(1),
    "rpm/s": Fraction(1),
    "counts/s": _COUNTS,
    "counts/s2": _COUNTS,
    "rev/s": _REVOLUTIONS,
    "rev/s2": _REVOLUTIONS,
}
_NO_LIMIT = 0xFFFF_FFFF
_DEFAULTS = {
    **dict.fromkeys(((0x607F, 0), (0x6080, 0), (0x60C5, 0), (0x60C6, 0)), _NO_LIMIT),
    **{(index, sub): 1 for index in (0x604C, 0x608F, *range(0x6090, 0x6098)) for sub in (1, 2)},
    **{(index, sub): value for index in (0x6048, 0x6049) for sub, value in ((1, 3000), (2, 1))},
    (0x6046, 2): 3000,
    (0x605A, 0): 2,
    (0x605D, 0): 1,
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
    modes: Sequence[int] = (1, 3, 6)
    pdos: int = 4
    fixed: bool = False
    """Controlword and Statusword in PDO 1, and no other mapping."""
    event_timer: bool = True
    life_guarding: bool = False
    """100Ch and 100Dh, no heartbeats."""
    units: Sequence[str] = ("counts/s", "counts/s2")
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


def _per(unit: str) -> Fraction:
    """How many of these units one rpm or one rpm/s is."""
    factor, _, base = unit.rpartition(" ")
    return _BASES[base] / Fraction(factor or 1)


@cache
def _shape(name: str) -> Shape:
    sheet = SHEETS[name]
    velocity, acceleration = map(_per, sheet.units)
    ramp = int(_RAMP * acceleration)
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
        velocity_per_rpm=velocity,
        acceleration_per_rpm_s=acceleration,
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


def _sheet(keys: dict[str, Any]) -> Sheet:
    defaults = addresses(keys.pop("defaults", {}))
    refused = {int(number): text for number, text in keys.pop("refused", {}).items()}
    return Sheet(**{**keys, "defaults": defaults, "refused": refused})


_TABLES = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))["sheet"]
SHEETS: Mapping[str, Sheet] = {sheet.name: sheet for sheet in map(_sheet, _TABLES)}
"""By maker and product."""
