"""Everything of a session through independent readers: tshark calls nothing malformed, scapy rebuilds it byte for byte."""

from __future__ import annotations

import re
import subprocess
from functools import cache
from pathlib import Path
from uuid import UUID

import pytest
from scapy.contrib.pnio import ProfinetIO
from scapy.contrib.pnio_rpc import PNIOServiceReqPDU, PNIOServiceResPDU
from scapy.layers.dcerpc import DceRpc4
from scapy.layers.inet import UDP
from scapy.layers.l2 import Ether
from scapy.utils import wrpcap

from pdgw.base.durations import MS
from pdgw.profidrive.telegrams import telegram
from pdgw.profinet.blocks.alarm import MessageClass
from pdgw.profinet.model import API_PROFIDRIVE, ObjectKind, object_module
from pdgw.profinet.records.device_records import Index
from pdgw.profinet.rpc import dcerpc
from pdgw.profinet.rpc.client import RecordCaller, RecordResult
from pdgw.profinet.rpc.dcerpc import ACYCLIC_PORT
from pdgw.profinet.rpc.identification import INDEX as IM0
from pdgw.profinet.rpc.identification import Im0, encode_im0
from pdgw.profinet.station import Neighbour
from tests.support.readers import tshark, tshark_frames
from tests.support.wire.profinet import (
    DEVICE_IP,
    INTERFACE_ADJUST,
    PLC_IP,
    PORT_ADJUST,
    PORT_CHECK,
    Wire,
    model,
    project,
)

AXIS = (1, 2)
ACCESS_POINT = (1, 1)

PORT_RECORDS = [
    (0x8001, Index.PORT_DATA_CHECK, PORT_CHECK),
    (0x8001, Index.PORT_DATA_ADJUST, PORT_ADJUST),
    (0x8000, Index.INTERFACE_ADJUST, INTERFACE_ADJUST),
]
READS = [
    *((0, 0, 1, index) for index in (Index.EXPECTED_AR, Index.REAL_AR, Index.MODULE_DIFF, Index.REAL_API)),
    *((API_PROFIDRIVE, 1, 1, index) for index in (Index.EXPECTED_SUBSLOT, Index.REAL_SUBSLOT)),
    *((API_PROFIDRIVE, 1, 1, index) for index in (Index.EXPECTED_SLOT, Index.REAL_SLOT)),
    *((API_PROFIDRIVE, 1, 1, index) for index in (Index.DIAGNOSIS_CHANNEL_SUBSLOT, Index.DIAGNOSIS_ALL_SLOT)),
    *((API_PROFIDRIVE, 1, 1, index) for index in (Index.DIAGNOSIS_STATUS_AR, Index.DIAGNOSIS_CHANNEL_API)),
    (0, 0, 0x8001, Index.PORT_DATA_REAL),
    (0, 0, 0x8001, Index.STATISTIC),
    (0, 0, 0x8000, Index.INTERFACE_DATA_REAL),
    *((API_PROFIDRIVE, 1, 2, index) for index in (Index.INPUT_DATA, Index.OUTPUT_DATA)),
    *((0, 0, place, index) for place, index, _ in PORT_RECORDS),
    (0, 0, 1, Index.DIAGNOSIS_STATUS_DEVICE),
    (0, 0, 1, Index.EXPECTED_DATA),
    (0, 0, 1, Index.REAL_DATA),
    (0, 0, 1, Index.AR_DATA),
    (0, 0, 1, Index.API_DATA),
    (0, 0, 1, Index.LOG_DATA),
    (0, 0, 1, Index.IM_FILTER),
    (0, 0, 1, IM0),
]


Session = tuple[Wire, list[tuple[tuple[int, int, int, int], RecordResult]]]


@cache
def session() -> Session:
    """A whole session: a wrong module, alarms, records, release."""
    modules = dict(model().modules)
    modules[2] = object_module(ObjectKind.AXIS, telegram(1))
    records = [
        (API_PROFIDRIVE, 1, 1, 0xB02E, bytes.fromhex("0101000110000 3c50000".replace(" ", ""))),
        *((0, 0, subslot, index, data) for subslot, index, data in PORT_RECORDS),
    ]
    wire = Wire(of_project=project(modules, records=records))
    wire.application.records[0, 1, IM0] = encode_im0(Im0(0xFFFF, "PDGW", "4711", 1, ("V", 0, 1, 0)))
    wire.device.set_diagnosis(ACCESS_POINT, MessageClass.TEMPERATURE)
    wire.connect()
    wire.station.neighbour = Neighbour(b"\7plc-1", b"\7port-001", bytes.fromhex("020000000001"), wire.now, 20_000 * MS)
    wire.plc.set_output(AXIS, bytes.fromhex("047f2000"))
    wire.run(20 * MS)
    wire.device.set_diagnosis(ACCESS_POINT, MessageClass.MAINS)
    wire.run(20 * MS)
    results: list[tuple[tuple[int, int, int, int], RecordResult]] = []
    for api, slot, subslot, index in READS:

        def keep(result: RecordResult, key: tuple[int, int, int, int] = (api, slot, subslot, index)) -> None:
            results.append((key, result))

        wire.plc.read((api, slot, subslot), index, keep)
    wire.run(100 * MS)
    wire.device.clear_diagnosis(ACCESS_POINT)
    wire.device.returned(AXIS)
    wire.run(100 * MS)
    wire.plc.release(wire.now)
    wire.run(20 * MS)
    return wire, results


def test_every_record_of_the_table_can_be_read() -> None:
    _, results = session()
    assert [key for key, _ in results] == READS
    refused = [(f"{key[3]:04X}h", result.status.text) for key, result in results if result.status.value]
    assert refused == []


@tshark.needs_tshark
@pytest.mark.tshark
def test_tshark_reads_every_frame_of_a_session(tmp_path: Path) -> None:
    wire, _ = session()
    names = [
        "pn_rt.frame_id",
        "pn_io.block_type",
        "pn_io.index",
        "pn_io.alarm_type",
        "pn_io.channel_error_type",
        "pn_io.ar_uuid",
        "pn_io.control_command.applready",
        "pn_io.control_command.prmend",
        "pn_io.module_state",
        "pn_io.error_code",
        "pn_rt.cycle_counter",
        "pn_rt.ds",
    ]
    rows = tshark_frames.read(wire.frames, tmp_path / "session.pcap", names, every=True)
    found = {part for row in rows for part in row["pn_io.block_type"].split(",") if part}
    types = {int(part, 0) for part in found}
    assert types >= {0x0101, 0x0102, 0x0103, 0x0104, 0x8101, 0x8102, 0x8103, 0x8104, 0x8106, 0x0110, 0x8110, 0x0112}
    assert types >= {
        0x8112,
        0x0114,
        0x8114,
        0x0002,
        0x8002,
        0x0012,
        0x0013,
        0x020F,
        0x0240,
        0x0251,
        0x0020,
        0x0010,
        0x0018,
    }
    alarms = [row for row in rows if row["pn_io.alarm_type"]]
    told = [(int(row["pn_io.alarm_type"], 0), row["pn_io.channel_error_type"]) for row in alarms]
    kinds = [kind for kind, _ in told]
    assert kinds.count(1) == 4, "two diagnoses appear, each notification has its AlarmAck"
    assert kinds.count(0x0C) == 4
    assert kinds.count(0x0B) == 2
    assert {int(text, 0) for _, text in told if text} == {MessageClass.TEMPERATURE, MessageClass.MAINS}
    statuses = {row["pn_rt.ds"] for row in rows if row["pn_rt.ds"]}
    assert {int(status, 0) for status in statuses} == {0x35, 0x15}


IDENTIFICATIONS = {
    "EXPECTED": "ExpectedIdentificationData",
    "REAL": "RealIdentificationData",
    "DIAGNOSIS_CHANNEL": "Diagnosis in channel coding",
    "DIAGNOSIS_ALL": "Diagnosis in all codings",
    "DIAGNOSIS_STATUS": "Diagnosis, Maintenance, Qualified and Status",
}
SCOPES = {"SUBSLOT": "subslot", "SLOT": "slot", "AR": "AR", "API": "API"}
RECORD_NAMES = {
    **{
        f"{kind}_{scope}": f"{name} for one {of}"
        for kind, name in IDENTIFICATIONS.items()
        for scope, of in SCOPES.items()
        if (kind, scope) != ("EXPECTED", "API")
    },
    **{
        f"MAINTENANCE_{grade.upper()}_{kind}_SUBSLOT": f"Maintenance {grade} in {coding} for one subslot"
        for grade in ("required", "demanded")
        for kind, coding in (("CHANNEL", "channel coding"), ("ALL", "all codings"))
    },
    "DIAGNOSIS_STATUS_DEVICE": "Diagnosis, Maintenance, Qualified and Status for one device",
    "INPUT_DATA": "RecordInputDataObjectElement for one subslot",
    "OUTPUT_DATA": "RecordOutputDataObjectElement for one subslot",
    "MODULE_DIFF": "ModuleDiffBlock for one AR",
    "PORT_DATA_REAL": "PDPortDataReal for one subslot",
    "PORT_DATA_CHECK": "PDPortDataCheck for one subslot",
    "PORT_DATA_ADJUST": "PDPortDataAdjust for one subslot",
    "NETWORK_COMPONENT_CHECK": "PDNCDataCheck for one subslot",
    "INTERFACE_ADJUST": "PDInterfaceAdjust for one subslot",
    "STATISTIC": "PDPortStatistic for one subslot",
    "INTERFACE_DATA_REAL": "PDInterfaceDataReal",
    "FAST_STARTUP_ADJUST": "PDInterfaceFSUDataAdjust",
    "AR_DATA": "ARData",
    "API_DATA": "APIData",
    "LOG_DATA": "LogData",
    "IM_FILTER": "I&M0FilterData",
    "REAL_DATA": "PDRealData",
    "EXPECTED_DATA": "PDExpectedData",
}


@tshark.needs_tshark
@pytest.mark.tshark
def test_every_record_index_has_the_same_name_in_tshark(tmp_path: Path) -> None:
    caller = RecordCaller(UUID(int=5), dcerpc.object_uuid(1, 0x0402, 0xFFFF), UUID(int=7))
    ends = (PLC_IP, 50_000), (str(DEVICE_IP.address), dcerpc.ACYCLIC_PORT)
    packets = [packet for index in Index for packet in caller.read(0, 0, 1, index, implicit=True).packets]
    wrpcap(str(tmp_path / "reads.pcap"), [Ether(tshark_frames.datagram(packet, *ends)) for packet in packets])
    command = ["tshark", "-n", "-V", "-r", str(tmp_path / "reads.pcap")]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    names = re.findall(r"^ +Index: (.*) \(0x[0-9a-f]{4}\)$", printed, re.MULTILINE)
    assert dict(zip([item.name for item in Index], names, strict=True)) == RECORD_NAMES


def test_scapy_rebuilds_every_rpc_and_cyclic_frame_byte_for_byte() -> None:
    wire, _ = session()
    calls = cyclic = 0
    for frame in wire.frames:
        packet = Ether(frame)
        if UDP in packet:
            whole = bytes(packet[UDP].payload)
            assert ACYCLIC_PORT in {packet[UDP].sport, packet[UDP].dport}
            rebuilt = DceRpc4(whole)
            assert PNIOServiceReqPDU in rebuilt or PNIOServiceResPDU in rebuilt
            rebuilt.clear_cache()
            assert bytes(rebuilt) == whole
            calls += 1
        elif ProfinetIO in packet and 0x8000 <= packet[ProfinetIO].frameID < 0xF800:
            packet.clear_cache()
            assert bytes(packet) == frame
            cyclic += 1
    assert calls > 30
    assert cyclic > 30
