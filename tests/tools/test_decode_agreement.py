"""The decoder against tshark and scapy, field by field, on the same captures."""

from __future__ import annotations

import csv
import io
import struct
from pathlib import Path

import pytest
from scapy.layers.can import CAN
from scapy.utils import PcapReader

from pdgw.base.durations import MS
from pdgw.profidrive.scapy_layers import ProfidriveCyclic, bind
from pdgw.tools.decoder.capture.source import open_source
from pdgw.tools.decoder.frames.canopen.can_records import EmcyRecord, HeartbeatRecord, NmtRecord, PdoRecord, SdoRecord
from pdgw.tools.decoder.frames.engine import Decoder, Settings, given_axes
from pdgw.tools.decoder.frames.records import CyclicRecord, ParameterRequestRecord, ParameterResponseRecord, Record
from tests.support.readers import captures, tshark
from tests.support.readers.captures import BEGIN_NS

CANOPEN = ("-d", "can.subdissector,canopen")


def records(path: Path, telegrams: tuple[int, ...] = (1,)) -> list[Record]:
    decoder = Decoder(Settings(given_axes(telegrams)))
    with open_source(str(path)) as source:
        return [decoder.decode(packet) for packet in source.packets]


def number(text: str) -> int:
    return int(text, 0)


@tshark.needs_tshark
@pytest.mark.tshark
@pytest.mark.parametrize("ending", ["pcap", "pcapng"])
def test_cyclic_frames_as_tshark_reads_them(tmp_path: Path, ending: str) -> None:
    plc = [packet for packet in captures.both_buses() if packet[1] == captures.ETHERNET]
    path = tmp_path / f"plc.{ending}"
    path.write_bytes(captures.pcap(plc) if ending == "pcap" else captures.pcapng(plc))
    ours = records(path)
    status = {"primary": "ds_primary", "data_valid": "ds_valid", "run": "ds_operate", "no_problem": "ds_ok"}
    names = ["frame_id", "cycle_counter", "ds", "transfer_status", *status.values()]
    rows = tshark.fields(path, ["frame.number", "frame.time_epoch", *(f"pn_rt.{name}" for name in names)])
    assert len(rows) == len(ours) == len(plc)
    for row, record in zip(rows, ours, strict=True):
        assert isinstance(record, CyclicRecord)
        assert number(row["frame.number"]) == record.number
        assert int(row["frame.time_epoch"].replace(".", "")) == record.time_ns
        assert number(row["pn_rt.frame_id"]) == record.frame_id
        assert number(row["pn_rt.cycle_counter"]) == record.cycle_counter
        assert number(row["pn_rt.ds"]) == record.data_status
        assert number(row["pn_rt.transfer_status"]) == record.transfer_status
        document = record.document()["data_status"]
        assert {name: bool(number(row[f"pn_rt.{field}"])) for name, field in status.items()} == {
            name: document[name] for name in status
        }


@tshark.needs_tshark
@pytest.mark.tshark
def test_canopen_frames_as_tshark_reads_them(tmp_path: Path) -> None:
    path = tmp_path / "can.pcap"
    frames = [
        (BEGIN_NS + i * MS, captures.SOCKETCAN, captures.socketcan_packet(cob_id, data))
        for i, (cob_id, data) in enumerate(captures.CANOPEN)
    ]
    path.write_bytes(captures.pcap(frames))
    ours = records(path)
    names = [
        *("cob_id", "node_id", "sdo.main_idx", "sdo.sub_idx", "sdo.abort_code", "em.err_code", "em.err_reg"),
        *("nmt_ctrl.cd", "nmt_ctrl.node_id", "nmt_guard.state", "pdo.data.bytes"),
    ]
    rows = tshark.fields(path, [f"canopen.{name}" for name in names], CANOPEN)
    assert len(rows) == len(ours) == len(frames)
    kinds = set()
    for raw, record in zip(rows, ours, strict=True):
        row = {name: raw[f"canopen.{name}"] for name in names}
        document = record.document()
        kinds.add(type(record))
        assert number(row["cob_id"]) == document["cob_id"]
        if row["node_id"] and not isinstance(record, NmtRecord):
            assert number(row["node_id"]) == getattr(record, "node", 0)
        if isinstance(record, SdoRecord):
            assert (number(row["sdo.main_idx"]), number(row["sdo.sub_idx"])) == (record.index, record.subindex)
            assert bool(row["sdo.abort_code"]) == (record.abort is not None)
            if record.abort is not None:
                assert number(row["sdo.abort_code"]) == record.abort
        elif isinstance(record, EmcyRecord):
            assert (number(row["em.err_code"]), number(row["em.err_reg"])) == (record.code, record.register)
        elif isinstance(record, NmtRecord):
            assert (number(row["nmt_ctrl.cd"]), number(row["nmt_ctrl.node_id"])) == (record.command, record.node)
        elif isinstance(record, HeartbeatRecord):
            assert number(row["nmt_guard.state"]) == record.state
        elif isinstance(record, PdoRecord):
            assert bytes.fromhex(row["pdo.data.bytes"]) == record.data
    assert kinds >= {SdoRecord, EmcyRecord, NmtRecord, HeartbeatRecord, PdoRecord}


EXCHANGES = [
    ("02 01 00 01 10 00 03 C5 00 00", "02 01 00 01 06 01 03 29"),
    ("03 02 01 01 10 00 03 9A 00 00 42 01 00 09", "03 02 01 01"),
    ("04 01 01 02 10 00 03 9A 00 00 10 00 13 88 00 00", "04 81 01 02 42 01 00 09 44 01 00 00"),
    ("05 01 02 01 10 02 03 B3 00 08", "05 01 02 01 42 02 00 01 00 02"),
    ("06 02 01 01 10 00 60 41 00 00 43 01 00 00 00 07", "06 82 01 01 44 02 00 03 00 01"),
    ("07 01 01 01 10 00 EA 60 00 00", "07 01 01 01 08 01 45 3B 80 00"),
]


@tshark.needs_tshark
@pytest.mark.tshark
def test_parameter_access_as_tshark_reads_it(tmp_path: Path) -> None:
    path = tmp_path / "rpc.pcap"
    exchanges = [(bytes.fromhex(request), bytes.fromhex(answer)) for request, answer in EXCHANGES]
    packets = captures.parameter_packets(exchanges)
    path.write_bytes(captures.pcap([(BEGIN_NS + i * MS, captures.ETHERNET, data) for i, data in enumerate(packets)]))
    ours = records(path)
    prefix = "pn_io.profidrive.parameter."
    names = [
        *("request_reference", "request_id", "response_id", "do", "no_of_parameters", "attribute", "no_of_elems"),
        *(
            "number",
            "index",
            "format",
            "no_of_values",
            "value_w",
            "value_dw",
            "value_float",
            "error_num",
            "error_subindex",
        ),
    ]
    rows = tshark.fields(path, ["pn_io.index", "pn_io.slot_nr", "_ws.malformed", *(prefix + name for name in names)])
    assert len(rows) == len(ours) == 4 * len(EXCHANGES)
    requests = [record for record in ours if isinstance(record, ParameterRequestRecord)]
    responses = [record for record in ours if isinstance(record, ParameterResponseRecord)]
    assert len(requests) == len(responses) == len(EXCHANGES)
    for raw, record in zip(rows, ours, strict=True):
        assert not raw["_ws.malformed"]
        assert number(raw["pn_io.index"]) == record.document()["record"]["index"]
        assert number(raw["pn_io.slot_nr"]) == record.document()["record"]["slot"]
        row = {name: raw[prefix + name] for name in names}
        if isinstance(record, ParameterRequestRecord):
            request = record.request
            address = request.addresses[0]
            assert number(row["request_reference"]) == request.reference
            assert number(row["request_id"]) == request.request_id
            assert (number(row["do"]), number(row["no_of_parameters"])) == (request.do_id, len(request.addresses))
            assert (number(row["attribute"]), number(row["no_of_elems"])) == (address.attribute, address.elements)
            assert (number(row["number"]), number(row["index"])) == (address.pnu, address.subindex)
            values = request.values
        elif isinstance(record, ParameterResponseRecord):
            response = record.response
            assert number(row["request_reference"]) == response.reference
            assert number(row["response_id"]) == response.request_id | 0x80 * response.negative
            assert (number(row["do"]), number(row["no_of_parameters"])) == (response.do_id, response.count)
            values = response.values
            assert record.request is not None
            assert record.request.reference == response.reference
        else:
            assert not row["request_reference"]
            continue
        if values:
            assert number(row["format"]) == values[0].format.code
            assert number(row["no_of_values"]) == len(values[0].values)
            assert not isinstance(values[0].values, bytes)
            words = ("error_num", "error_subindex") if values[0].failed else ("value_w", "value_dw")
            shown: list[float] = [number(row[name]) for name in words if row[name]]
            shown += [float(row["value_float"])] if row["value_float"] else []
            # Of several values tshark's first is compared.
            assert shown == list(values[0].values)[: len(shown)]
            assert shown


def test_signals_as_scapy_reads_them(tmp_path: Path) -> None:
    path = tmp_path / "both.pcapng"
    path.write_bytes(captures.pcapng(captures.both_buses()))
    ours = records(path)
    bind([1])
    with PcapReader(str(path)) as reader:
        theirs = list(reader)
    assert len(ours) == len(theirs)
    for packet, record in zip(theirs, ours, strict=True):
        if isinstance(record, CyclicRecord):
            pdu = packet[ProfidriveCyclic]
            assert (pdu.cycleCounter, int(pdu.dataStatus)) == (record.cycle_counter, record.data_status)
            (unit,) = record.units
            assert [int(getattr(pdu.data[0], item.name)) for item, _ in unit.items()] == list(unit.values)
            assert (pdu.data[1].dataState << 7, pdu.data[2].dataState << 7) == (unit.iops, unit.iocs)
        else:
            assert packet[CAN].identifier == record.document()["cob_id"]
            assert bytes(packet[CAN].data) == record.data


def test_the_table_of_a_capture_is_what_plain_struct_reads(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from pdgw.tools.commands.capture.decode import decode  # noqa: PLC0415

    path = tmp_path / "both.pcapng"
    packets = captures.both_buses()
    path.write_bytes(captures.pcapng(packets))
    decode([str(path)], telegram=[1], csv="stw1,nsoll_a,Target Velocity")
    rows = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
    expected = []
    for time_ns, link, data in packets:
        time = f"{time_ns // 10**9}.{time_ns % 10**9:09d}"
        if link == captures.ETHERNET and data[42:44] == b"\xc0\x01":
            word, speed = struct.unpack_from(">Hh", data, 44)
            expected.append((time, str(word), str(speed * 100 / 16384), ""))
        elif link == captures.SOCKETCAN and data[:4] == b"\0\0\x02\x01":
            expected.append((time, "", "", str(struct.unpack_from("<i", data, 8)[0])))
    assert [(r["time"], r["stw1"], r["nsoll_a"], r["Target Velocity"]) for r in rows] == expected
