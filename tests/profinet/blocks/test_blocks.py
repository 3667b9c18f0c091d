"""Declared blocks against scapy's, and what a damaged one is refused with."""

from __future__ import annotations

from dataclasses import replace
from uuid import UUID

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scapy.contrib import pnio_rpc

from pdgw.profinet.blocks import connect_blocks, control
from pdgw.profinet.blocks.connect_blocks import (
    AlarmCrBlockReq,
    ArBlockReq,
    DataDescription,
    ExpectedSlot,
    ExpectedSubmodule,
    ExpectedSubmoduleBlockReq,
    IocrApi,
    IocrBlockReq,
    Place,
)
from pdgw.profinet.rpc.dcerpc import object_uuid
from pdgw.profinet.wire import Block, WireError, number_of, split

AR_UUID = UUID(int=0x1234)
INITIATOR = object_uuid(1, 2, 3)
MAC = bytes.fromhex("020000000001")

AR = ArBlockReq(
    ar_type=connect_blocks.ArType.IO,
    ar_uuid=AR_UUID,
    session_key=7,
    initiator_mac=MAC,
    initiator_object=INITIATOR,
    properties=0x40000011,
    activity_timeout=200,
    rt_port=0x8892,
    station_name="plc-1",
)
IOCR = IocrBlockReq(
    iocr_type=connect_blocks.IocrType.INPUT,
    reference=1,
    lt=0x8892,
    properties=2,
    data_length=40,
    frame_id=0x8001,
    send_clock=32,
    reduction_ratio=4,
    phase=1,
    sequence=0,
    frame_send_offset=0xFFFFFFFF,
    watchdog=3,
    data_hold=3,
    tag=0xC000,
    multicast_mac=bytes(6),
    apis=(IocrApi(api=0, data=(Place(slot=0, subslot=1, offset=0),), iocs=(Place(slot=1, subslot=2, offset=5),)),),
)
ALARM = AlarmCrBlockReq(
    cr_type=1,
    lt=0x8892,
    properties=0,
    rta_timeout=1,
    rta_retries=3,
    reference=5,
    max_length=200,
    tag_high=0xC000,
    tag_low=0xA000,
)
EXPECTED = ExpectedSubmoduleBlockReq(
    slots=(
        ExpectedSlot(
            api=0x3A00,
            slot=1,
            ident=0x1000,
            properties=0,
            submodules=(
                ExpectedSubmodule(
                    subslot=2,
                    ident=0x10001,
                    properties=3,
                    descriptions=(
                        DataDescription(direction=1, length=4, length_iocs=1, length_iops=1),
                        DataDescription(direction=2, length=4, length_iocs=1, length_iops=1),
                    ),
                ),
            ),
        ),
    )
)
SCAPY = {
    ArBlockReq: pnio_rpc.ARBlockReq(
        ARType=1,
        ARUUID=str(AR_UUID),
        SessionKey=7,
        CMInitiatorMacAdd="02:00:00:00:00:01",
        CMInitiatorObjectUUID=str(INITIATOR),
        ARProperties_StartupMode=1,
        ARProperties_ParametrizationServer=1,
        ARProperties_State=1,
        CMInitiatorActivityTimeoutFactor=200,
        CMInitiatorUDPRTPort=0x8892,
        CMInitiatorStationName=b"plc-1",
    ),
    IocrBlockReq: pnio_rpc.IOCRBlockReq(
        IOCRType=1,
        IOCRReference=1,
        IOCRProperties_RTClass=2,
        DataLength=40,
        FrameID=0x8001,
        SendClockFactor=32,
        ReductionRatio=4,
        Phase=1,
        Sequence=0,
        FrameSendOffset=0xFFFFFFFF,
        WatchdogFactor=3,
        DataHoldFactor=3,
        IOCRTagHeader_IOUserPriority=6,
        IOCRMulticastMACAdd="00:00:00:00:00:00",
        APIs=[
            pnio_rpc.IOCRAPI(
                API=0,
                IODataObjects=[pnio_rpc.IOCRAPIObject(SlotNumber=0, SubslotNumber=1, FrameOffset=0)],
                IOCSs=[pnio_rpc.IOCRAPIObject(SlotNumber=1, SubslotNumber=2, FrameOffset=5)],
            )
        ],
    ),
    AlarmCrBlockReq: pnio_rpc.AlarmCRBlockReq(
        AlarmCRProperties_Priority=0,
        RTATimeoutFactor=1,
        RTARetries=3,
        LocalAlarmReference=5,
        MaxAlarmDataLength=200,
        AlarmCRTagHeaderHigh=0xC000,
        AlarmCRTagHeaderLow=0xA000,
    ),
    ExpectedSubmoduleBlockReq: pnio_rpc.ExpectedSubmoduleBlockReq(
        APIs=[
            pnio_rpc.ExpectedSubmoduleAPI(
                API=0x3A00,
                SlotNumber=1,
                ModuleIdentNumber=0x1000,
                Submodules=[
                    pnio_rpc.ExpectedSubmodule(
                        SubslotNumber=2,
                        SubmoduleIdentNumber=0x10001,
                        SubmoduleProperties_Type=3,
                        DataDescription=[
                            pnio_rpc.ExpectedSubmoduleDataDescription(
                                DataDescription=direction, SubmoduleDataLength=4, LengthIOCS=1, LengthIOPS=1
                            )
                            for direction in (1, 2)
                        ],
                    )
                ],
            )
        ]
    ),
}
OURS: list[Block] = [AR, IOCR, ALARM, EXPECTED]


@pytest.mark.parametrize("block", OURS, ids=lambda block: type(block).__name__)
def test_a_block_is_byte_for_byte_what_scapy_builds_and_reads_back(block: Block) -> None:
    data = block.encode()
    assert data == bytes(SCAPY[type(block)])
    assert type(block).decode(data) == block


def test_control_blocks_are_what_scapy_builds() -> None:
    ours = control.PrmEndReq(ar_uuid=AR_UUID, session_key=7, command=control.ControlCommand.PRM_END)
    theirs = pnio_rpc.IODControlReq(
        block_type=0x0110, ARUUID=str(AR_UUID), SessionKey=7, ControlCommand_PrmEnd=1, ControlBlockProperties=0
    )
    assert ours.encode() == bytes(theirs)
    assert control.PrmEndReq.decode(ours.encode()) == ours


@pytest.mark.parametrize("block", OURS, ids=lambda block: type(block).__name__)
def test_a_block_cut_short_is_refused_by_its_length(block: Block) -> None:
    data = block.encode()
    for cut in range(6, len(data)):
        short = data[:2] + (cut - 4).to_bytes(2, "big") + data[4:cut]
        with pytest.raises(WireError) as refusal:
            type(block).decode(short)
        assert refusal.value.number == 1


@pytest.mark.parametrize("block", OURS, ids=lambda block: type(block).__name__)
@pytest.mark.parametrize(("position", "number"), [(0, 0), (3, 1), (4, 2), (5, 3)])
def test_a_wrong_header_is_refused_by_its_field(block: Block, position: int, number: int) -> None:
    data = bytearray(block.encode())
    data[position] ^= 0x40
    with pytest.raises(WireError) as refusal:
        type(block).decode(bytes(data))
    assert refusal.value.number == number


def test_byte_after_the_last_field_is_a_length_error() -> None:
    data = AR.encode() + b"\0"
    longer = data[:2] + (len(data) - 4).to_bytes(2, "big") + data[4:]
    with pytest.raises(WireError) as refusal:
        ArBlockReq.decode(longer)
    assert refusal.value.number == 1


def test_received_blocks_with_any_values_are_decoded() -> None:
    strange = replace(AR, ar_type=0x20, ar_uuid=UUID(int=0), initiator_mac=b"\1" * 6, station_name="no name!")
    assert ArBlockReq.understand(strange.encode()) == strange
    with pytest.raises(WireError):
        ArBlockReq.decode(strange.encode())
    with pytest.raises(WireError):
        ArBlockReq.understand(strange.encode()[:-1])


def test_numbers_of_fields_count_through_nested_lists_as_the_standard_does() -> None:
    assert number_of(ArBlockReq, "properties") == 0x09
    assert number_of(IocrBlockReq, "apis.data.slot") == 0x16
    assert number_of(IocrBlockReq, "apis.iocs.offset") == 0x1C
    assert number_of(ExpectedSubmoduleBlockReq, "slots.submodules.descriptions.length") == 0x0E
    assert number_of(AlarmCrBlockReq, "tag_low") == 0x0C
    with pytest.raises(KeyError):
        number_of(AlarmCrBlockReq, "colour")


@given(st.lists(st.sampled_from(OURS), max_size=6))
def test_blocks_in_any_order_are_distinguished(blocks: list[Block]) -> None:
    data = b"".join(block.encode() for block in blocks)
    found = list(split(data))
    assert [kind for kind, _ in found] == [block.TYPE for block in blocks]
    assert b"".join(whole for _, whole in found) == data


@given(st.sampled_from(OURS), st.data())
def test_a_damaged_block_is_read_or_refused_with_a_field_it_has(block: Block, data: st.DataObject) -> None:
    damaged = bytearray(block.encode())
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    refusal, again = None, None
    try:
        again = type(block).decode(bytes(damaged))
    except WireError as error:
        refusal = error
    if again is not None:
        assert again.encode() == bytes(damaged)
    else:
        assert refusal is not None
        assert 0 <= refusal.number <= 0x1C
