"""All parameters of a drive object in a file, and back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from pdgw.base.validation import problems
from pdgw.ds301.communication import PREDEFINED_ERROR_FIELD
from pdgw.ds301.objects import COMMUNICATION_AREA
from pdgw.dsp402.objects import ABORT_OPTION, DRIVE_OBJECTS
from pdgw.gateway.base.errors import GatewayError, at_most, writing
from pdgw.gateway.client.address import Target, parse_type, parse_value
from pdgw.gateway.client.session import NOT_THERE, Element, Progress, Session, address_text
from pdgw.gateway.configuration.toml_file import read_text
from pdgw.profidrive.parameters.catalogue import OBJECT_PNUS
from pdgw.profidrive.parameters.codec import Values
from pdgw.profidrive.parameters.description import Pnu
from pdgw.profidrive.parameters.error_numbers import ParameterErrorNumber

FORMAT_VERSION = 1
_COMMANDS = {
    Pnu.CONTROL_PRIORITY,
    Pnu.FAULT_SITUATIONS,
    Pnu.LOAD,
    Pnu.SAVE,
    Pnu.RESET,
    Pnu.LOAD_DEVICE,
    Pnu.SAVE_DEVICE,
}
"""Parameters whose write starts an action; they are not settings."""
_PROCESS = {
    DRIVE_OBJECTS.attribute(name).index
    for name in (
        "controlword",
        "modes_of_operation",
        "target_torque",
        "target_position",
        "digital_outputs",
        "target_velocity",
    )
}
"""Demands of the moment."""
_LAST = (Pnu.TELEGRAM, Pnu.OPERATION_PRIORITY)
"""Parameters to write last: another telegram makes the gateway configure the drive again; without the priority nothing more
can be written.
"""

_TYPE_FIELDS = 2
"""Manufacturer and drive unit type come first in P964; version, date and number of axes may differ."""

Pair = tuple["DumpedElement", Element]
"""A setting of the file, and what the device has."""


class DumpedElement(BaseModel):
    """One element; ``setting``: restoring writes it."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    pnu: Annotated[int, Field(ge=1, le=0xFFFF)]
    subindex: Annotated[int, Field(ge=0, le=0xFFFE)]
    format: str
    value: int | float | str
    setting: bool
    array: bool = False

    @property
    def target(self) -> Target:
        return Target(self.pnu, self.subindex) if self.array else Target(self.pnu)

    def values(self) -> Values:
        """For the parameter channel; GatewayError when format and value do not fit together."""
        try:
            return parse_value(str(self.value), parse_type(self.format))
        except GatewayError as error:
            raise GatewayError(f"{address_text(self.pnu, self.subindex)}: {error}") from error


class Dump(BaseModel):
    """The file."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    version: Annotated[int, AfterValidator(at_most(FORMAT_VERSION))] = FORMAT_VERSION
    do_id: int
    unit: tuple[int, ...] = ()
    """P964."""
    parameters: tuple[DumpedElement, ...]

    def save(self, path: Path) -> None:
        """GatewayError when it cannot be written."""
        with writing(path):
            path.write_text(self.model_dump_json(indent=1), encoding="utf-8")

    @classmethod
    def load(cls, path: Path) -> Dump:
        """Check a dump; GatewayError names the error in the file."""
        try:
            return cls.model_validate_json(read_text(path))
        except ValidationError as error:
            raise GatewayError(f"{path}: not a parameter file: {problems(error, cls)[0].line}") from error


def read_all(session: Session, progress: Progress | None = None) -> tuple[Dump, list[Element]]:
    """Every parameter the device lists, and the elements that could not be read."""
    pnus = [pnu for pnu in session.pnus() if pnu != PREDEFINED_ERROR_FIELD]
    descriptions = session.describe(pnus)
    elements = session.read([Target(pnu) for pnu in pnus], progress)
    dumped, failed = [], []
    for element in elements:
        if element.failed or element.format is None or element.value is None:
            # Sub-indices of an object may be missing.
            if element.error not in NOT_THERE:
                failed.append(element)
            continue
        description = descriptions.get(element.pnu)
        array = description is not None and description.array
        writable = description is not None and description.writable
        dumped.append(
            DumpedElement(
                pnu=element.pnu,
                subindex=element.subindex,
                format=element.format.name,
                value=element.value,
                setting=writable and _is_setting(element, array=array),
                array=array,
            )
        )
    unit = tuple(
        element.value for element in elements if element.pnu == Pnu.DRIVE_UNIT and isinstance(element.value, int)
    )
    return Dump(do_id=session.client.do_id, unit=unit, parameters=tuple(dumped)), failed


def _is_setting(element: Element, *, array: bool) -> bool:
    pnu = element.pnu
    if pnu in _COMMANDS or pnu in _PROCESS or pnu in COMMUNICATION_AREA or pnu == ABORT_OPTION:
        return False
    return not (pnu in OBJECT_PNUS and array and element.subindex == 0)


def other_origin(session: Session, dump: Dump) -> str:
    """Name the origin of a file that was saved from another drive object or another type of device; empty for a match."""
    if dump.do_id != session.client.do_id:
        return f"DO {dump.do_id}"
    found = session.read([Target(Pnu.DRIVE_UNIT)])
    unit = tuple(element.value for element in found if isinstance(element.value, int))
    if dump.unit and unit and unit[:_TYPE_FIELDS] != dump.unit[:_TYPE_FIELDS]:
        return f"another device (P964 {dump.unit[0]}, {dump.unit[1]} instead of {unit[0]}, {unit[1]})"
    return ""


def difference(session: Session, dump: Dump, progress: Progress | None = None) -> list[Pair]:
    """The settings of the file that the device has otherwise (or not at all), in the order in which they are to be written.

    GatewayError when it is a device that has none of them, or answers with others.
    """
    settings = [element for element in dump.parameters if element.setting]
    present = session.read([element.target for element in settings], progress)
    if len(present) != len(settings):
        raise GatewayError("the device has other elements than the file: it is another device")
    silent = [found for found in present if found.error == ParameterErrorNumber.NOT_EXECUTABLE_IN_STATE]
    if silent:
        raise GatewayError(
            f"DO {session.client.do_id}: {len(silent)} of {len(present)} settings cannot be read "
            f"({silent[0].error_text}); check that the device is online (pdgw status)"
        )
    if present and all(found.failed for found in present):
        raise GatewayError(f"DO {session.client.do_id} has none of the settings in the file: {present[0].error_text}")
    pairs = [pair for pair in zip(settings, present, strict=True) if pair[1].failed or pair[0].value != pair[1].value]
    return sorted(pairs, key=lambda pair: _LAST.index(pair[0].pnu) + 1 if pair[0].pnu in _LAST else 0)


def other_telegram(pairs: Sequence[Pair]) -> tuple[int, int] | None:
    """The telegrams of the device and of the file, where they differ."""
    for saved, found in pairs:
        if saved.pnu == Pnu.TELEGRAM and isinstance(saved.value, int) and isinstance(found.value, int):
            return found.value, saved.value
    return None


@dataclass(frozen=True, slots=True)
class Restored:
    """Result of a restore: an element for each setting that was tried, with its error where it failed.

    ``taken_back``: what had been written has its old value again; ``stuck`` could not be given it back.
    """

    written: list[Element]
    failed: list[Element]
    taken_back: bool = False
    stuck: tuple[Element, ...] = ()


def restore(
    session: Session, pairs: Sequence[Pair], progress: Progress | None = None, *, partial: bool = False
) -> Restored:
    """Write settings, all or none: after a failure the old values are written back, unless ``partial``."""
    written: list[Element] = []
    failed: list[Element] = []
    old: list[tuple[Target, Values]] = []
    # Parameters that must be written last wait until all others are accepted.
    parts = [[pair for pair in pairs if pair[0].pnu not in _LAST], *([pair] for pair in pairs if pair[0].pnu in _LAST)]
    for part in parts:
        results = session.write([(saved.target, saved.values()) for saved, _ in part], progress)
        for result, (saved, found) in zip(results, part, strict=True):
            (failed if result.failed else written).append(result)
            if not result.failed and found.format is not None:
                old.append((saved.target, parse_value(str(found.value), found.format)))
        if failed and not partial:
            back = session.write(old[::-1])
            return Restored(written, failed, True, tuple(item for item in back if item.failed))
    return Restored(written, failed)
