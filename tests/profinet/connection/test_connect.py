"""Every error code of the Connect table has a case; a rejection has no lasting effect."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar
from uuid import UUID

import pytest

from pdgw.profinet.blocks.connect_blocks import (
    AlarmCrBlockReq,
    ArBlockReq,
    ExpectedSubmoduleBlockReq,
    IocrApi,
    IocrBlockReq,
    IocrType,
    Place,
)
from pdgw.profinet.rpc.records import PnioStatus
from pdgw.profinet.wire import Block, u16, u32
from tests.support.wire.connect import Caller, Change, blocks, change
from tests.support.wire.profinet import Wire


def without(kind: type[Block], index: int = 0) -> Change:
    def apply(items: list[Block]) -> list[Block]:
        place = [number for number, item in enumerate(items) if isinstance(item, kind)][index]
        return items[:place] + items[place + 1 :]

    return apply


def twice(kind: type[Block]) -> Change:
    return lambda items: [*items, next(item for item in items if isinstance(item, kind))]


def iocr_api(edit: Callable[[Any], Any], index: int = 0) -> Change:
    """Edit the first API of an IOCR."""

    def apply(items: list[Block]) -> list[Block]:
        place = [number for number, item in enumerate(items) if isinstance(item, IocrBlockReq)][index]
        block = items[place]
        assert isinstance(block, IocrBlockReq)
        items[place] = replace(block, apis=(edit(block.apis[0]), *block.apis[1:]))
        return items

    return apply


def slot(edit: Callable[[Any], Any]) -> Change:
    """Edit the expected slot of the second expected block."""

    def apply(items: list[Block]) -> list[Block]:
        place = [number for number, item in enumerate(items) if isinstance(item, ExpectedSubmoduleBlockReq)][1]
        block = items[place]
        assert isinstance(block, ExpectedSubmoduleBlockReq)
        items[place] = replace(block, slots=tuple(edit(item) for item in block.slots))
        return items

    return apply


def submodule(edit: Callable[[Any], Any], index: int = 1) -> Change:
    """Edit a submodule (the telegram's by default) of the first axis."""

    def on_slot(item: Any) -> Any:
        found = list(item.submodules)
        found[index] = edit(found[index])
        return replace(item, submodules=tuple(found))

    return slot(on_slot)


def description(edit: Callable[[Any], Any]) -> Change:
    return submodule(lambda item: replace(item, descriptions=(edit(item.descriptions[0]), *item.descriptions[1:])))


def places(which: str, edit: Callable[[Place], Place]) -> Change:
    def on_api(api: Any) -> Any:
        found = getattr(api, which)
        return replace(api, **{which: (edit(found[0]), *found[1:])})

    return iocr_api(on_api)


# The input relationship contains the IOCS of the output data after API 3A00h; the first API has none of them.
def iocs_of_output(edit: Callable[[Place], Place]) -> Change:
    def apply(items: list[Block]) -> list[Block]:
        return iocr_api(lambda api: replace(api, iocs=(edit(api.iocs[0]), *api.iocs[1:])), 1)(items)

    return apply


def also(which: str, kind: IocrType, place: Place, times: int = 1) -> Change:
    """One more place in the relationship of a direction, in its own API 0."""

    def apply(items: list[Block]) -> list[Block]:
        number = kind - IocrType.INPUT
        index = [at for at, item in enumerate(items) if isinstance(item, IocrBlockReq)][number]
        block = items[index]
        assert isinstance(block, IocrBlockReq)
        kept = [api for api in block.apis if api.api]
        first = next((api for api in block.apis if not api.api), IocrApi(api=0, data=(), iocs=()))
        changed = replace(first, **{which: (*getattr(first, which), *[place] * times)})
        items[index] = replace(block, apis=(changed, *kept))
        return items

    return apply


@dataclass(frozen=True, kw_only=True)
class Redundancy(Block):
    """SRInfoBlock, which a device without system redundancy does not know."""

    TYPE: ClassVar[int] = 0x010A
    hold: int = u16()
    properties: int = u32()


CASES: list[tuple[int, int, str, Change]] = [
    (0x01, 0x04, "AR type unknown", change(ArBlockReq, ar_type=0x0010)),
    (
        0x01,
        0x04,
        "AR of system redundancy",
        lambda items: [Redundancy(hold=200, properties=5), *change(ArBlockReq, ar_type=0x0020)(items)],
    ),
    (0x01, 0x05, "ARUUID null", change(ArBlockReq, ar_uuid=UUID(int=0))),
    (0x01, 0x07, "group MAC of the initiator", change(ArBlockReq, initiator_mac=bytes.fromhex("010000000001"))),
    (0x01, 0x08, "object UUID of the initiator", change(ArBlockReq, initiator_object=UUID(int=5))),
    (0x01, 0x09, "AR not active", change(ArBlockReq, properties=0x10)),
    (0x01, 0x09, "parameterised by somebody else", change(ArBlockReq, properties=0x01)),
    (0x01, 0x09, "companion AR reserved", change(ArBlockReq, properties=0x611)),
    (0x01, 0x09, "device access without its type", change(ArBlockReq, properties=0x111)),
    (0x01, 0x0A, "activity timeout 0", change(ArBlockReq, activity_timeout=0)),
    (0x01, 0x0A, "activity timeout 1001", change(ArBlockReq, activity_timeout=1001)),
    (0x01, 0x0C, "name length 0", change(ArBlockReq, station_name="")),
    (0x01, 0x0D, "characters of the name", change(ArBlockReq, station_name="pl c")),
    (0x02, 0x04, "IOCR type", change(IocrBlockReq, iocr_type=3)),
    (0x02, 0x06, "LT", change(IocrBlockReq, lt=0x0800)),
    (0x02, 0x07, "RT class 3", change(IocrBlockReq, properties=3)),
    (0x02, 0x07, "reserved bits", change(IocrBlockReq, properties=0x12)),
    (0x02, 0x08, "data length 39", change(IocrBlockReq, data_length=39)),
    (0x02, 0x08, "data length 1441", change(IocrBlockReq, data_length=1441)),
    (0x02, 0x09, "FrameID of another class", change(IocrBlockReq, frame_id=0xC001)),
    (0x02, 0x09, "input FrameID left to the device", change(IocrBlockReq, frame_id=0xFFFF)),
    (0x02, 0x0A, "send clock 33", change(IocrBlockReq, send_clock=33)),
    (0x02, 0x0A, "send clock 256", change(IocrBlockReq, send_clock=256)),
    (0x02, 0x0B, "ratio 0", change(IocrBlockReq, reduction_ratio=0)),
    (0x02, 0x0B, "ratio 513", change(IocrBlockReq, reduction_ratio=513)),
    (0x02, 0x0B, "shorter than MinDeviceInterval", change(IocrBlockReq, send_clock=1)),
    (0x02, 0x0C, "phase 0", change(IocrBlockReq, phase=0)),
    (0x02, 0x0C, "phase beyond the ratio", change(IocrBlockReq, phase=5)),
    (0x02, 0x0E, "send offset beyond the clock", change(IocrBlockReq, frame_send_offset=1_000_000)),
    (0x02, 0x0F, "watchdog 0", change(IocrBlockReq, watchdog=0)),
    (0x02, 0x10, "hold 0", change(IocrBlockReq, data_hold=0)),
    (0x02, 0x10, "hold beyond 1.92 s", change(IocrBlockReq, data_hold=481)),
    (0x02, 0x11, "VLAN", change(IocrBlockReq, tag=0xC001)),
    (0x02, 0x11, "priority 5", change(IocrBlockReq, tag=0xA000)),
    (0x02, 0x13, "no API", change(IocrBlockReq, apis=())),
    (0x02, 0x14, "API unknown", iocr_api(lambda api: replace(api, api=0x9999))),
    (0x02, 0x15, "API empty", iocr_api(lambda api: replace(api, data=(), iocs=()))),
    (0x02, 0x16, "slot unknown", places("data", lambda item: replace(item, slot=9))),
    (0x02, 0x17, "subslot unknown", places("data", lambda item: replace(item, subslot=9))),
    (0x02, 0x17, "subslot twice", iocr_api(lambda api: replace(api, data=(*api.data, api.data[0])))),
    (0x02, 0x18, "data outside", places("data", lambda item: replace(item, offset=1000))),
    (
        0x02,
        0x18,
        "data over data",
        iocr_api(lambda api: replace(api, data=tuple(replace(p, offset=0) for p in api.data))),
    ),
    (
        0x02,
        0x17,
        "output data of a submodule without data",
        also("data", IocrType.OUTPUT, Place(slot=0, subslot=1, offset=39)),
    ),
    (0x02, 0x18, "IOPS just outside", places("data", lambda item: replace(item, offset=42))),
    (0x02, 0x1B, "IOCS of the direction's own data", also("iocs", IocrType.INPUT, Place(slot=0, subslot=1, offset=39))),
    (0x02, 0x1B, "IOCS twice", also("iocs", IocrType.OUTPUT, Place(slot=0, subslot=1, offset=39), times=2)),
    (0x02, 0x18, "data over IOCS", iocs_of_output(lambda item: replace(item, offset=0))),
    (
        0x02,
        0x1C,
        "IOCS over IOCS",
        iocr_api(lambda api: replace(api, iocs=tuple(replace(p, offset=39) for p in api.iocs)), 1),
    ),
    (0x02, 0x1A, "slot of IOCS unknown", iocs_of_output(lambda item: replace(item, slot=9))),
    (0x02, 0x1B, "subslot of IOCS unknown", iocs_of_output(lambda item: replace(item, subslot=9))),
    (0x02, 0x1C, "IOCS outside", iocs_of_output(lambda item: replace(item, offset=0xFFFF))),
    (0x03, 0x04, "no API expected", change(ExpectedSubmoduleBlockReq, slots=())),
    (0x03, 0x06, "slot beyond 7FFFh", slot(lambda item: replace(item, slot=0x8000))),
    (0x03, 0x06, "a slot in two APIs", slot(lambda item: replace(item, slot=0))),
    (0x03, 0x07, "module ident 0", slot(lambda item: replace(item, ident=0))),
    (0x03, 0x09, "no submodule", slot(lambda item: replace(item, submodules=()))),
    (0x03, 0x0A, "subslot 0", submodule(lambda item: replace(item, subslot=0))),
    (0x03, 0x0A, "subslot twice", submodule(lambda item: replace(item, subslot=1))),
    (
        0x03,
        0x0A,
        "submodule without data in the IOCRs",
        slot(lambda item: replace(item, submodules=(*item.submodules, replace(item.submodules[1], subslot=3)))),
    ),
    (
        0x03,
        0x0A,
        "IOPS without IOCS of a submodule without data",
        iocr_api(lambda api: replace(api, iocs=api.iocs[1:]), 1),
    ),
    (0x03, 0x0C, "no status of a submodule with data", submodule(lambda item: replace(item, properties=0x23))),
    (0x03, 0x0C, "reserved properties", submodule(lambda item: replace(item, properties=0x43))),
    (0x03, 0x0D, "direction unknown", description(lambda item: replace(item, direction=3))),
    (0x03, 0x0D, "two outputs", description(lambda item: replace(item, direction=2))),
    (0x03, 0x0E, "data longer than a frame", description(lambda item: replace(item, length=1440))),
    (
        0x03,
        0x0E,
        "data of a submodule without data",
        submodule(lambda item: replace(item, descriptions=(replace(item.descriptions[0], length=1),)), 0),
    ),
    (0x03, 0x0F, "IOPS length", description(lambda item: replace(item, length_iops=2))),
    (0x03, 0x10, "IOCS length", description(lambda item: replace(item, length_iocs=0))),
    (0x04, 0x04, "alarm CR type", change(AlarmCrBlockReq, cr_type=2)),
    (0x04, 0x05, "alarm LT", change(AlarmCrBlockReq, lt=0x0800)),
    (0x04, 0x07, "RTA factor 0", change(AlarmCrBlockReq, rta_timeout=0)),
    (0x04, 0x07, "RTA factor 101", change(AlarmCrBlockReq, rta_timeout=101)),
    (0x04, 0x08, "retries 2", change(AlarmCrBlockReq, rta_retries=2)),
    (0x04, 0x08, "retries 16", change(AlarmCrBlockReq, rta_retries=16)),
    (0x04, 0x0A, "alarm length 199", change(AlarmCrBlockReq, max_length=199)),
    (0x04, 0x0A, "alarm length 1433", change(AlarmCrBlockReq, max_length=1433)),
    (0x04, 0x0B, "priority of high alarms", change(AlarmCrBlockReq, tag_high=0xA000)),
    (0x04, 0x0C, "priority of low alarms", change(AlarmCrBlockReq, tag_low=0xC000)),
    (0x40, 0x02, "input IOCR missing", without(IocrBlockReq)),
    (0x40, 0x02, "output IOCR missing", without(IocrBlockReq, 1)),
    (0x40, 0x03, "AR missing", without(ArBlockReq)),
    (0x40, 0x03, "AR twice", twice(ArBlockReq)),
    (0x40, 0x03, "alarm CR missing", without(AlarmCrBlockReq)),
    (0x40, 0x03, "alarm CR twice", twice(AlarmCrBlockReq)),
    (0x40, 0x03, "three IOCRs", twice(IocrBlockReq)),
    (0x40, 0x03, "no expected block", lambda items: [i for i in items if not isinstance(i, ExpectedSubmoduleBlockReq)]),
]


@pytest.mark.parametrize(
    ("code1", "code2", "name", "edit"), CASES, ids=[f"{c[0]:02X} {c[1]:02X} {c[2]}" for c in CASES]
)
def test_a_refused_connect_names_block_and_field(code1: int, code2: int, name: str, edit: Change) -> None:
    caller = Caller()
    status, answered = caller.connect(edit(blocks()))
    assert status == PnioStatus(0xDB, 0x81, code1, code2), status.text
    assert answered == b""
    assert caller.wire.device.relation is None
    assert not caller.wire.device.cm.relations
    # No state remains: the same controller connects as for the first time.
    status, _ = caller.connect(blocks())
    assert not status.value, status.text


RAW = [
    (0x05, 0x04, "parameter server", bytes.fromhex("0105 0004 0100 0000")),
    (0x06, 0x04, "multicast CR", bytes.fromhex("0106 0004 0100 0000")),
    (0x40, 0x01, "SR info", bytes.fromhex("010a 0004 0100 0000")),
    (0x40, 0x01, "unknown block", bytes.fromhex("7777 0004 0100 0000")),
    (0x40, 0x00, "header cut short", b"\1\2"),
    (0x40, 0x00, "unknown block longer than the request", bytes.fromhex("7777 7777 0100")),
    (0x01, 0x01, "AR block longer than the request", bytes.fromhex("0101 7777 0100")),
    (0x01, 0x01, "AR block cut short", bytes.fromhex("0101 0004 0100 0001")),
    (0x02, 0x01, "IOCR block cut short", bytes.fromhex("0102 0004 0100 0001")),
    (0x03, 0x01, "expected block cut short", bytes.fromhex("0104 0004 0100 0001")),
    (0x04, 0x01, "alarm block cut short", bytes.fromhex("0103 0004 0100 0001")),
    *(
        (
            block.ERROR_CODE1,
            field,
            f"{block.__name__} version {version}",
            bytes.fromhex(f"{block.TYPE:04x} 0004 {version} 0001"),
        )
        for block in (ArBlockReq, IocrBlockReq, ExpectedSubmoduleBlockReq, AlarmCrBlockReq)
        for field, version in ((2, "0200"), (3, "0101"))
    ),
]


@pytest.mark.parametrize(("code1", "code2", "name", "extra"), RAW, ids=[f"{c[0]:02X} {c[1]:02X} {c[2]}" for c in RAW])
def test_a_block_that_does_not_belong_refuses_the_connect(code1: int, code2: int, name: str, extra: bytes) -> None:
    caller = Caller()
    data = b"".join(block.encode() for block in blocks()) + extra
    if extra.startswith(b"\1\1"):
        data = extra + data
    status, _ = caller.call(data)
    assert status == PnioStatus(0xDB, 0x81, code1, code2), status.text
    assert not caller.wire.device.cm.relations


TABLE = {
    0x01: "01 02 03 04 05 07 08 09 0A 0C 0D",
    0x02: "01 02 03 04 06 07 08 09 0A 0B 0C 0E 0F 10 11 13 14 15 16 17 18 1A 1B 1C",
    0x03: "01 02 03 04 06 07 09 0A 0C 0D 0E 0F 10",
    0x04: "01 02 03 04 05 07 08 0A 0B 0C",
    0x05: "04",
    0x06: "04",
    0x40: "00 01 02 03",
}
"""Every refusal of a single request, by ErrorCode1. 40 04 and 40 06 need a second request, 40 05 is one of the other services:
they have tests of their own."""


def test_every_code_of_the_table_has_a_case() -> None:
    provoked = {(code1, code2) for code1, code2, *_ in (*CASES, *RAW)}
    wanted = {(code1, int(code2, 16)) for code1, codes in TABLE.items() for code2 in codes.split()}
    assert sorted(wanted - provoked) == []
    assert sorted(provoked - wanted) == []


@pytest.mark.parametrize(
    "extra", ["0107 0002 0100", "0108 0004 0100 0000", "0109 0006 0100 00000000", "010b 0002 0100"]
)
def test_blocks_that_change_nothing_here_are_skipped(extra: str) -> None:
    caller = Caller()
    status, _ = caller.call(b"".join(block.encode() for block in blocks()) + bytes.fromhex(extra))
    assert not status.value, status.text


def test_an_ar_of_another_type_is_refused_by_its_type_not_by_its_further_blocks() -> None:
    caller = Caller()
    for kind, extra in ((0x10, "0109 0006 0100 00000000"), (0x20, "010a 0004 0100 0000")):
        data = bytes.fromhex(extra) + b"".join(block.encode() for block in change(ArBlockReq, ar_type=kind)(blocks()))
        status, _ = caller.call(data)
        assert (status.code1, status.code2) == (0x01, 0x04)


def test_a_second_controller_is_refused_and_the_first_one_keeps_its_relationship() -> None:
    wire = Wire()
    wire.connect()
    relation = wire.device.relation
    status, _ = Caller(wire, ("192.168.0.9", 50_000)).connect(blocks())
    assert status == PnioStatus(0xDB, 0x81, 0x40, 0x04)
    assert wire.device.relation is relation
    wire.run(100_000_000)
    assert wire.device.connected


def test_the_same_ar_with_a_new_call_is_in_the_wrong_state() -> None:
    caller = Caller()
    assert not caller.connect(blocks())[0].value
    assert caller.connect(blocks())[0] == PnioStatus(0xDB, 0x81, 0x40, 0x06)
    assert caller.wire.device.relation is not None


def test_connect_answer_beyond_the_callers_limit_is_rejected() -> None:
    caller = Caller()
    status, _ = caller.call(b"".join(block.encode() for block in blocks()), maximum=20)
    assert status == PnioStatus(0xDB, 0x81, 0x40, 0x00)
    assert not caller.wire.device.cm.relations


@pytest.mark.parametrize(("kind", "code1"), [(ArBlockReq, 0x01), (IocrBlockReq, 0x02)])
@pytest.mark.parametrize("missing", [1, 2, 3, 4, 7, 11, 16])
def test_a_block_shorter_than_its_fields_is_refused_by_its_length(kind: type[Block], code1: int, missing: int) -> None:
    for bytes_follow in (True, False):
        data = b""
        for block in blocks():
            encoded = block.encode()
            if isinstance(block, kind):
                length = len(encoded) - 4 - missing
                encoded = encoded[:2] + length.to_bytes(2, "big") + encoded[4:]
                encoded = encoded if bytes_follow else encoded[: 4 + length]
            data += encoded
        status, _ = Caller().call(data)
        assert status == PnioStatus(0xDB, 0x81, code1, 0x01), status.codes
