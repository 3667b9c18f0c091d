"""The values of a device in the configuration: ``dcf``, and the table ``objects`` of an axis or encoder.

Objects that the gateway writes itself are never written from a file.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Final

from pydantic import Strict

from pdgw.base.validation import misplaced
from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.objects import ObjectAddress
from pdgw.ds301.values import DeviceValue, DeviceValues

_OWNED: Final = (
    (0x1003, 0x1003),  # errors
    (0x1005, 0x1007),  # SYNC
    (0x100C, 0x100D),  # node guarding
    (0x1010, 0x1017),  # storing, EMCY, heartbeats
    (0x1019, 0x1020),  # SYNC counter, configuration
    (0x1400, 0x1BFF),  # PDOs
    (0x1F00, 0x1FFF),  # program control, NMT start-up
    (0x6003, 0x6003),  # preset of an encoder
    (0x6007, 0x6007),  # abort option
    (0x6040, 0x6042),
    (0x6060, 0x6061),  # mode
    (0x6071, 0x6071),
    (0x607A, 0x607A),
    (0x6098, 0x6099),  # homing
    (0x60B0, 0x60B1),
    (0x60C1, 0x60C2),  # interpolation
    (0x60FE, 0x60FF),
    (0x6200, 0x6200),  # cyclic timer of an encoder
)
"""First and last index of objects that the gateway writes itself, or that command or erase a device."""
_NAME: Final = re.compile(r"(?:0x)?([0-9A-Fa-f]{4})h?(?:[./]([0-9]{1,3}))?")
_LAST_SUBINDEX: Final = 0xFF

Value = Annotated[int, Strict()] | Annotated[float, Strict()] | str


def is_owned(index: int) -> bool:
    """Whether an object is written by the gateway alone."""
    return any(first <= index <= last for first, last in _OWNED)


def address_of(name: str) -> ObjectAddress | None:
    """Index and sub-index of an object that is written as in a configuration: ``6085h``, ``2210h.3``. None for another text."""
    found = _NAME.fullmatch(name)
    if found is None or (subindex := int(found[2] or 0)) > _LAST_SUBINDEX:
        return None
    return int(found[1], 16), subindex


def check_objects(objects: dict[str, Value]) -> dict[str, Value]:
    """Check the names of a table ``objects``."""
    if owned := [name for name in objects if (known := address_of(name)) and is_owned(known[0])]:
        raise misplaced(f"{', '.join(owned)}: the gateway itself writes this object; delete it", *owned[0].split("."))
    seen: set[ObjectAddress] = set()
    for name in objects:
        place = name.split(".")
        address = address_of(name)
        if address is None:
            raise misplaced(f'{name!r} is not an object, expected for example "6085h" or "2210h.3"', *place)
        if address in seen:
            raise misplaced(f"{name}: the object is there twice; delete one line", *place)
        seen.add(address)
    return objects


def device_values(
    section: str, node_id: int, dcf: Path | None, eds: Path | None, objects: Mapping[str, Value]
) -> DeviceValues:
    """The values of a device. ``section``: of its table, ``axis`` or ``encoder``.

    CanopenError for a file that cannot be used, a value that is none of its type, or two values for one object.
    """
    # Imported here: slow to load, and not needed by commands without a device.
    import canopen  # noqa: PLC0415

    from pdgw.ds301.eds.dcf import read_dcf  # noqa: PLC0415
    from pdgw.ds301.eds.importer import import_eds  # noqa: PLC0415
    from pdgw.ds301.eds.pdos import variable  # noqa: PLC0415
    from pdgw.ds301.eds.text import EdsError  # noqa: PLC0415

    if dcf is None and not objects:
        return DeviceValues()
    try:
        of_file = DeviceValues() if dcf is None else read_dcf(dcf, node_id, is_owned)
        sheet = canopen.ObjectDictionary() if eds is None or not objects else import_eds(eds, node_id).dictionary
    except EdsError as error:
        raise CanopenError("DCF", str(dcf or eds), f"a usable DCF ({error})") from error
    table = f"[{section}.objects]"
    found = {item.address: item for item in of_file.items}
    for name, value in objects.items():
        address = address_of(name)
        assert address is not None
        declared = variable(sheet, *address)
        item = DeviceValue(*address, value, table, 0 if declared is None else declared.data_type)
        if item.data_type:
            item.encoded()
        before = found.setdefault(address, item)
        if before is not item and not before.is_held_by(item.encoded(len(before.encoded()))):
            allowed = f"{before.text()} as in {before.source}; delete one of both"
            raise CanopenError(f"{item.name} of {table}", item.text(), allowed)
    if not objects:
        return of_file
    source = f"{of_file.source} and {table}" if dcf is not None else table
    return DeviceValues(tuple(found.values()), source, of_file.skipped, identity=of_file.identity)
