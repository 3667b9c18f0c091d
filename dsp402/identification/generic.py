"""Identify and describe a CiA 402 drive without a data sheet.

Identify a drive by SDO uploads; nothing is written. Source: CiA 301 (SDO upload), CiA 402. Describe a CiA 402 drive without a
data sheet: read from the device which objects of the profile it has. Source: CiA 301 and CiA 402. Types and PDO mapping flags
are those of the profile; a device that differs needs its EDS.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import canopen
from canopen.objectdictionary import ODArray, ODRecord, ODVariable

from pdgw.ds301.aborts import SdoCommunicationError
from pdgw.ds301.communication import DEVICE_NAME, IDENTITY_PRODUCT, IDENTITY_VENDOR, communication_objects, pdo_objects
from pdgw.ds301.eds.importer import import_eds
from pdgw.ds301.eds.pdos import variable
from pdgw.ds301.node.sdo import Inquiry
from pdgw.ds301.objects import Entry, ObjectKind, ObjectSpec
from pdgw.ds301.pdo import PdoDirection
from pdgw.dsp402.acting import ACTING, read_acting, readable
from pdgw.dsp402.drive_type import DriveType, Dsp402Error
from pdgw.dsp402.identification.describe import (
    PROFILE_AREA,
    describe,
    questions,
    signed,
)
from pdgw.dsp402.identification.overlay import NO_CHOICE, Families
from pdgw.dsp402.objects import DRIVE_OBJECTS, FURTHER_OBJECTS, PDOS
from pdgw.dsp402.units.mechanics import UnitKeys


def probe(
    node: Inquiry,
    dictionary: canopen.ObjectDictionary | None,
    units: UnitKeys | None = None,
    families: Families = NO_CHOICE,
) -> DriveType:
    """The drive at this node, with its data sheet or without, in a task; Dsp402Error when none answers."""
    try:
        if dictionary is None:
            vendor, product = (node.number(*address) or 0 for address in (IDENTITY_VENDOR, IDENTITY_PRODUCT))
            dictionary = dictionary_of(node.node_id, node.fetch, vendor, product, families)
        answers = _answers(dictionary, node.fetch)
        acting = read_acting(ACTING, dictionary, node.fetch, answers)
    except SdoCommunicationError as error:
        raise Dsp402Error(f"node {node.node_id}", str(error), "a drive that answers SDO") from error
    return replace(describe(dictionary, answers, units, families), acting=readable(acting))


def _answers(dictionary: canopen.ObjectDictionary, read: Read) -> dict[tuple[int, int], int]:
    answers = {}
    for index, subindex in questions(dictionary):
        data = read(index, subindex)
        declared = variable(dictionary, index, subindex)
        if data and declared is not None:
            data = data[: max(1, len(declared) // 8)]
            answers[index, subindex] = int.from_bytes(data, "little", signed=signed(dictionary, (index, subindex)))
    return answers


Read = Callable[[int, int], bytes | None]
"""Reads an object of the device; None where the device does not have it."""


@cache
def generic_objects() -> tuple[ObjectSpec, ...]:
    """Everything a CiA 402 drive may have that the gateway uses, without limits and defaults."""
    profile = (spec for spec in DRIVE_OBJECTS.objects if spec.index in PROFILE_AREA)
    return (
        *communication_objects(0, "", (0, 0, 0, 0), ("", "")),
        *pdo_objects(PDOS, PDOS, ()),
        *sorted((*profile, *FURTHER_OBJECTS), key=lambda spec: spec.index),
    )


@cache
def generic_dictionary() -> canopen.ObjectDictionary:
    """The object dictionary of a drive that was not read yet: one shared object, do not change it."""
    return _dictionary(None, lambda *_: b"")


def discovered_dictionary(node_id: int, read: Read) -> canopen.ObjectDictionary:
    """The object dictionary of the device that ``read`` reads, without missing objects and sub-indices.

    Communication parameters and mappings have the device's values as defaults. Raises the errors of ``read``.
    """
    dictionary = _dictionary(node_id, read)
    name = read(DEVICE_NAME, 0)
    if name:
        dictionary.device_information.product_name = name.decode("latin-1").rstrip("\0 ").strip()
    return dictionary


def dictionary_of(
    node_id: int, read: Read, vendor_id: int, product_code: int, families: Families = NO_CHOICE
) -> canopen.ObjectDictionary:
    """The object dictionary of a device without a configured data sheet: the package's where it has one, else discovered."""
    found = families.of(vendor_id, product_code)
    path = found.eds_path if found is not None else None
    if path is not None:
        packaged = import_eds(path, node_id).dictionary
        information = packaged.device_information
        if (information.vendor_number, information.product_number) == (vendor_id, product_code):
            return packaged
    return discovered_dictionary(node_id, read)


def _dictionary(node_id: int | None, read: Read) -> canopen.ObjectDictionary:
    dictionary = canopen.ObjectDictionary()
    dictionary.node_id = node_id
    missing: set[PdoDirection] = set()
    for spec in generic_objects():
        direction = _direction(spec.index)
        if direction in missing:
            continue
        item = _object(spec, read)
        if item is not None:
            dictionary.add_object(item)
        elif direction is not None:
            missing.add(direction)  # PDO numbers have no gaps: the first missing one is the end
    return dictionary


def _direction(index: int) -> PdoDirection | None:
    for direction in PdoDirection:
        if direction.communication_index <= index < direction.communication_index + PDOS:
            return direction
    return None


def _object(spec: ObjectSpec, read: Read) -> ODVariable | ODRecord | ODArray | None:
    if spec.kind is ObjectKind.VAR:
        entry = spec.entries[0]
        data = read(spec.index, 0)
        return None if data is None else _variable(entry, data)
    first = read(spec.index, 0)
    if first is None:
        return None
    item = (ODArray if spec.kind is ObjectKind.ARRAY else ODRecord)(spec.name, spec.index)
    highest = first[0] if first else len(spec.entries)
    item.add_member(_variable(spec.entries[0], first))
    is_mapping = any(
        direction.mapping_index <= spec.index < direction.mapping_index + PDOS for direction in PdoDirection
    )
    for entry in spec.entries[1:]:
        # Sub-index 0 of a mapping is the number of mapped objects, not the possible number.
        data = read(spec.index, entry.subindex) if entry.subindex <= highest or is_mapping else None
        if data is not None:
            item.add_member(_variable(entry, data))
    return item


def _variable(entry: Entry, data: bytes) -> ODVariable:
    item = ODVariable(entry.name, entry.index, entry.subindex)
    item.data_type = entry.type.code
    item.access_type = entry.access.value
    item.pdo_mappable = entry.pdo
    if data and entry.type.char:
        size = entry.type.bits // 8
        item.default = int.from_bytes(data[:size], "little", signed=entry.type.char.islower())
    return item
