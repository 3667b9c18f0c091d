"""What a granted Connect answers, in whichever order its blocks come; what is damaged is refused or rejected."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import replace
from typing import Any
from uuid import UUID

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.peers.controller.project import INPUT_FRAME_ID, Layout, Project
from pdgw.profidrive.telegrams import telegram
from pdgw.profinet.blocks.connect_blocks import (
    DISCARD_IOXS,
    ArBlockRes,
    ArServerBlockRes,
    ExpectedSubmoduleBlockReq,
    IdentInfo,
    IocrBlockReq,
    IocrBlockRes,
    IocrType,
    ModuleDiffBlock,
    ModuleState,
    RtClass,
)
from pdgw.profinet.connection.connect import DataObject, plan
from pdgw.profinet.device import Refused
from pdgw.profinet.model import DeviceModel, Module, ObjectKind, Submodule, Subslot, object_module
from pdgw.profinet.rpc import dcerpc
from pdgw.profinet.rpc.dcerpc import PacketType, RpcHeader
from pdgw.profinet.rpc.records import Operation, PnioStatus, encode_arguments
from pdgw.profinet.wire import Block, split
from tests.support.wire.connect import AR_UUID, AXIS_SUBSLOTS, INITIATOR, SOURCE, Caller, blocks, change
from tests.support.wire.profinet import MS, PLC_MAC, Wire, model, project


def answered_blocks(data: bytes) -> dict[int, list[bytes]]:
    found: dict[int, list[bytes]] = {}
    for kind, block in split(data):
        found.setdefault(kind, []).append(block)
    return found


@pytest.mark.parametrize("little", [True, False])
def test_a_granted_connect_names_both_frame_ids_and_the_station(little: bool) -> None:
    caller = Caller()
    status, data = caller.call(b"".join(block.encode() for block in blocks()), little=little)
    assert not status.value
    found = answered_blocks(data)
    assert list(found) == [0x8101, 0x8102, 0x8103, 0x8106]
    assert ArBlockRes.decode(found[0x8101][0]).session_key == 1
    granted = [IocrBlockRes.decode(block) for block in found[0x8102]]
    assert [(block.iocr_type, block.reference) for block in granted] == [(1, 1), (2, 2)]
    assert granted[0].frame_id == 0x8001
    assert granted[1].frame_id in range(0x8000, 0xC000)
    assert granted[1].frame_id != 0x8001
    assert ArServerBlockRes.decode(found[0x8106][0]).station_name == "gateway"


@pytest.mark.parametrize(
    ("advanced", "rt_class"), [(True, RtClass.RT_CLASS_1), (False, RtClass.RT_CLASS_1), (False, RtClass.LEGACY)]
)
def test_legacy_and_advanced_start_up_are_both_granted(advanced: bool, rt_class: RtClass) -> None:
    status, data = Caller().connect(blocks(project(advanced=advanced, rt_class=rt_class)))
    assert not status.value, status.text
    assert (0x8106 in answered_blocks(data)) is advanced


def test_an_output_frame_id_the_controller_names_is_used_and_returned() -> None:
    status, data = Caller().connect(change(IocrBlockReq, 1, frame_id=0x8123)(blocks()))
    assert not status.value
    assert IocrBlockRes.decode(answered_blocks(data)[0x8102][1]).frame_id == 0x8123


@pytest.mark.parametrize("ratio", [1, 2, 4, 32, 128, 512])
def test_every_ratio_is_granted_from_one_millisecond_on(ratio: int) -> None:
    status, _ = Caller().connect(blocks(project(reduction_ratio=ratio)))
    assert not status.value, status.text


def test_device_access_needs_no_data_and_two_are_possible() -> None:
    caller = Caller()
    for number in (1, 2):
        ar = project().ar(UUID(int=number), number, PLC_MAC, INITIATOR, "tool")
        status, data = caller.connect([replace(ar, ar_type=6, properties=0x111)])
        assert not status.value
        assert list(answered_blocks(data)) == [0x8101]
    third = project().ar(UUID(int=3), 3, PLC_MAC, INITIATOR, "tool")
    assert caller.connect([replace(third, ar_type=6)])[0] == PnioStatus(0xDB, 0x81, 0x40, 0x04)
    (refused,) = caller.wire.device.events()
    assert isinstance(refused, Refused)
    assert refused.reason == "device access relationship: 3 is not allowed, expected at most 2"
    # Beside them a controller connects.
    assert not caller.connect(blocks())[0].value


class SameFrameId(Project):
    """Like a software controller: only the destination distinguishes the frames of both directions."""

    def iocr(self, kind: IocrType, layout: Layout) -> IocrBlockReq:
        return replace(super().iocr(kind, layout), frame_id=INPUT_FRAME_ID)


class LeftOut(Project):
    """As PC Worx asks for: submodules without data are in no relationship."""

    def layout(self, kind: IocrType, order: Sequence[Subslot] | None = None, gap: int = 0) -> Layout:
        assert order is None
        return super().layout(kind, [place for place in self.submodules if place not in self.empty], gap)

    @property
    def empty(self) -> list[Subslot]:
        return [place for place, item in self.submodules.items() if not item.inputs and not item.outputs]


class WithoutStatus(LeftOut):
    """As controllers ask for with DiscardIOXS: such submodules are listed, the frames have nothing of them."""

    def iocr(self, kind: IocrType, layout: Layout) -> IocrBlockReq:
        nothing = DataObject(0, 0)
        if kind is IocrType.INPUT:
            listed = replace(layout, data=dict.fromkeys(self.empty, nothing) | dict(layout.data))
        else:
            listed = replace(layout, iocs=dict.fromkeys(self.empty, 0) | dict(layout.iocs))
        return super().iocr(kind, listed)

    def expected(self) -> list[ExpectedSubmoduleBlockReq]:
        return [
            replace(
                block,
                slots=tuple(
                    replace(
                        slot,
                        submodules=tuple(
                            replace(item, properties=item.properties | (0 if item.direction else DISCARD_IOXS))
                            for item in slot.submodules
                        ),
                    )
                    for slot in block.slots
                ),
            )
            for block in super().expected()
        ]


@pytest.mark.parametrize("kind", [SameFrameId, LeftOut, WithoutStatus])
def test_requests_of_real_controllers_are_granted(kind: type[Project]) -> None:
    """Each seen in public captures of running machines."""
    wire = Wire(of_project=kind("gateway", model().modules))
    wire.connect()
    relation = wire.device.relation
    assert relation is not None
    assert relation.plan.diff is None
    setpoints, actuals = bytes(range(1, 5)), bytes(range(11, 15))
    wire.plc.set_output((1, 2), setpoints)
    wire.device.set_input((1, 2), actuals, good=True)
    wire.run(40 * MS)
    assert wire.device.output((1, 2)) == setpoints
    assert wire.plc.input((1, 2)) == actuals
    if kind is not SameFrameId:
        assert relation.plan.inputs is not None
        assert (0, 1) not in relation.plan.inputs.data
        assert relation.plan.inputs.data[1, 2].offset == 0


def wrong(place: int, module: Module | None) -> Project:
    modules = dict(model().modules)
    if module is not None:
        modules[place] = module
    return project(modules)


WRONG_IDENT = replace(object_module(ObjectKind.AXIS, telegram(1)), ident=0x1003)
ONE_MORE = replace(
    object_module(ObjectKind.AXIS, telegram(1)),
    submodules={**object_module(ObjectKind.AXIS, telegram(1)).submodules, 3: Submodule(0x00010001, 2, 2)},
)


def test_a_send_offset_within_the_send_clock_is_granted() -> None:
    status, _ = Caller().connect(change(IocrBlockReq, frame_send_offset=999_999)(blocks()))
    assert not status.value, status.text


def test_missing_submodule_is_reported_without_an_identification() -> None:
    status, data = Caller().connect(blocks(wrong(1, ONE_MORE)))
    assert not status.value
    (module,) = ModuleDiffBlock.decode(answered_blocks(data)[0x8104][0]).apis[0].modules
    assert [(item.subslot, item.ident, item.state) for item in module.submodules] == [(3, 0, 0x9800)]


@pytest.mark.parametrize(
    ("of_project", "state", "info", "proper"),
    [
        (wrong(1, object_module(ObjectKind.ENCODER, telegram(83))), ModuleState.WRONG, IdentInfo.WRONG, {2, 3}),
        (wrong(2, object_module(ObjectKind.AXIS, telegram(1))), ModuleState.PROPER, IdentInfo.WRONG, {1, 3}),
        (wrong(4, object_module(ObjectKind.AXIS, telegram(1))), ModuleState.NO_MODULE, None, {1, 2, 3}),
        (wrong(1, WRONG_IDENT), ModuleState.WRONG, IdentInfo.WRONG, {2, 3}),
        (wrong(1, ONE_MORE), ModuleState.PROPER, IdentInfo.NO_SUBMODULE, {1, 2, 3}),
    ],
    ids=[
        "wrong module",
        "wrong telegram",
        "no such module",
        "wrong module with the right telegram",
        "no such submodule",
    ],
)
def test_different_project_is_granted_with_the_list_of_differences(
    of_project: Project, state: ModuleState, info: IdentInfo | None, proper: set[int]
) -> None:
    status, data = Caller().connect(blocks(of_project))
    assert not status.value
    diff = ModuleDiffBlock.decode(answered_blocks(data)[0x8104][0])
    (module,) = diff.apis[0].modules
    assert module.state == state
    if info is not None:
        assert {(item.state >> 11) & 0xF for item in module.submodules} == {info}
    wire = Wire(of_project=of_project)
    wire.connect()
    for slot_number in of_project.modules:
        if slot_number and slot_number in model().modules:
            size = model().modules[slot_number].submodules[2].inputs
            wire.device.set_input((slot_number, 2), bytes(size), good=True)
            expected = of_project.modules[slot_number].submodules[2].outputs
            wire.plc.set_output((slot_number, 2), bytes(expected))
    wire.run(50_000_000)
    good = {place[0] for place in of_project.submodules if place[1] == 2 and wire.plc.input(place) is not None}
    assert good == proper
    assert {number for number in model().modules if wire.device.output((number, 2)) is not None} == proper
    assert wire.plc.learned.diff is not None


# -- any order, any offsets -------------------------------------------------------------------------------------------


@st.composite
def shuffled(draw: st.DrawFn) -> tuple[DeviceModel, list[Block], dict[IocrType, Layout]]:
    """A request with blocks, APIs, places and offsets in any order that the standard allows."""
    chosen = project()
    layouts: dict[IocrType, Layout] = {}
    items: list[Block] = []
    for kind in IocrType:
        order = draw(st.permutations(AXIS_SUBSLOTS))
        layouts[kind] = chosen.layout(kind, order, draw(st.integers(0, 3)))
        block = chosen.iocr(kind, layouts[kind])
        apis = draw(st.permutations(block.apis))
        items.append(
            replace(
                block,
                apis=tuple(
                    replace(
                        api,
                        data=tuple(draw(st.permutations(api.data))),
                        iocs=tuple(draw(st.permutations(api.iocs))),
                    )
                    for api in apis
                ),
            )
        )
    expected: list[Block] = [
        replace(
            block,
            slots=tuple(replace(s, submodules=tuple(draw(st.permutations(s.submodules)))) for s in block.slots),
        )
        for block in chosen.expected()
    ]
    if draw(st.booleans()):
        expected = [ExpectedSubmoduleBlockReq(slots=tuple(s for b in chosen.expected() for s in b.slots))]
    items += [*expected, chosen.alarm(), chosen.ar(AR_UUID, 1, PLC_MAC, INITIATOR, "plc-1")]
    return model(), draw(st.permutations(items)), layouts


@given(shuffled())
def test_blocks_places_and_offsets_may_come_in_any_order(
    case: tuple[DeviceModel, list[Block], dict[IocrType, Layout]],
) -> None:
    device, items, layouts = case
    granted = plan(b"".join(block.encode() for block in items), device)
    assert granted.inputs is not None
    assert granted.outputs is not None
    assert granted.diff is None
    for kind, found in ((IocrType.INPUT, granted.inputs), (IocrType.OUTPUT, granted.outputs)):
        assert dict(found.data) == dict(layouts[kind].data)
        assert dict(found.iocs) == dict(layouts[kind].iocs)


@given(st.data())
def test_a_damaged_connect_is_granted_or_refused_with_a_code_of_its_own(data: st.DataObject) -> None:
    caller = Caller()
    request = bytearray(b"".join(block.encode() for block in blocks()))
    for _ in range(data.draw(st.integers(1, 4))):
        request[data.draw(st.integers(0, len(request) - 1))] = data.draw(st.integers(0, 255))
    status, _ = caller.call(bytes(request[: data.draw(st.integers(0, len(request)))]))
    if status.value:
        assert (status.code, status.decode) == (0xDB, 0x81)
        assert status.code1 in {1, 2, 3, 4, 5, 6, 0x40}
        assert not caller.wire.device.cm.relations
    else:
        assert len(caller.wire.device.cm.relations) == 1


def test_lengths_that_contradict_each_other_are_rejected() -> None:
    wire = Wire()
    header = RpcHeader(PacketType.REQUEST, dcerpc.object_uuid(1, 0x0402, 0xFFFF), UUID(int=4), 0, Operation.CONNECT)
    wire.device.on_datagram(
        dcerpc.encode_packet(header, struct.pack("<5I", 100, 50, 100, 0, 60) + bytes(50)), SOURCE, 0
    )
    ((_, answer),) = wire.device.outgoing()
    kind, body = dcerpc.decode_packet(bytes(answer))
    assert kind.packet_type is PacketType.REJECT
    assert dcerpc.decode_status(body, little=True) == 0x1C01000B


@pytest.mark.parametrize(
    ("changes", "status"),
    [
        ({"operation": 9}, 0x1C010002),
        ({"interface": UUID(int=1)}, 0x1C010003),
        ({"interface_version": 2}, 0x1C010003),
        ({"object": dcerpc.object_uuid(1, 1, 1)}, 0x1C010003),
    ],
)
def test_call_to_another_device_is_rejected(changes: dict[str, Any], status: int) -> None:
    wire = Wire()
    header = RpcHeader(PacketType.REQUEST, dcerpc.object_uuid(1, 0x0402, 0xFFFF), UUID(int=4), 0, Operation.CONNECT)
    body = encode_arguments(100, b"", 100, little=True)
    wire.device.on_datagram(dcerpc.encode_packet(replace(header, **changes), body), SOURCE, 0)
    ((_, answer),) = wire.device.outgoing()
    kind, body = dcerpc.decode_packet(bytes(answer))
    assert kind.packet_type is PacketType.REJECT
    assert dcerpc.decode_status(body, little=True) == status
