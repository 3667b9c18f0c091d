"""The PDOs of a device as its data sheet shows them.

Source: CiA DS 301 V4.02 chapter 7.5.2.35-38 (1400h-1BFFh), CiA 306 (access, defaults and PDO mapping).
"""

from __future__ import annotations

from collections.abc import Iterator

import canopen
from canopen.objectdictionary import ODVariable

from pdgw.ds301.configuration import EVENT_TIMER, TRANSMISSION_TYPE
from pdgw.ds301.pdo import COB_ID_INVALID, COB_ID_NO_REMOTE, PDOS_MAX, PdoCapabilities, PdoDirection, PdoSlot

_MAPPED_OBJECTS = 8


def variable(dictionary: canopen.ObjectDictionary, index: int, subindex: int = 0) -> ODVariable | None:
    """The data sheet's entry at an address, None where it has none."""
    if index not in dictionary:
        return None
    item = dictionary[index]
    if isinstance(item, ODVariable):
        return item if subindex == 0 else None
    found: ODVariable | None = item.subindices.get(subindex)
    return found


def variables(dictionary: canopen.ObjectDictionary) -> Iterator[ODVariable]:
    """All entries of a data sheet, in its order."""
    for item in dictionary.values():
        if isinstance(item, ODVariable):
            yield item
        else:
            yield from item.values()


def pdo_capabilities(dictionary: canopen.ObjectDictionary) -> PdoCapabilities:
    mappable = {(item.index, item.subindex) for item in variables(dictionary) if item.pdo_mappable}
    return PdoCapabilities(
        _slots(dictionary, PdoDirection.RPDO), _slots(dictionary, PdoDirection.TPDO), frozenset(mappable)
    )


def _slots(dictionary: canopen.ObjectDictionary, direction: PdoDirection) -> tuple[PdoSlot, ...]:
    communication, mapping = direction.communication_index, direction.mapping_index
    return tuple(
        _slot(dictionary, number, communication + number - 1, mapping + number - 1)
        for number in range(1, PDOS_MAX + 1)
        if communication + number - 1 in dictionary
    )


def _slot(dictionary: canopen.ObjectDictionary, number: int, communication: int, mapping: int) -> PdoSlot:
    cob_id = variable(dictionary, communication, 1)
    count = variable(dictionary, mapping)
    type_ = variable(dictionary, communication, TRANSMISSION_TYPE)
    mapped = [variable(dictionary, mapping, sub) for sub in range(1, _MAPPED_OBJECTS + 1)]
    values = [value for item in mapped if (value := _default(item))]
    own = _default(cob_id)
    return PdoSlot(
        number,
        None if own is None else own & ~(COB_ID_INVALID | COB_ID_NO_REMOTE),
        _writable(cob_id),
        tuple(values[: _default(count)]),
        _writable(count),
        _writable(variable(dictionary, communication, EVENT_TIMER)),
        _default(type_),
        _writable(type_),
    )


def _default(item: ODVariable | None) -> int | None:
    return item.default if item is not None and isinstance(item.default, int) else None


def _writable(item: ODVariable | None) -> bool:
    return item is not None and bool(item.writable)
