"""tshark reads requests and responses of the parameter channel as we meant them, field by field."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from uuid import UUID

import pytest
from scapy.layers.inet import IP, UDP
from scapy.layers.l2 import Ether
from scapy.utils import wrpcap

from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.parameters import codec
from pdgw.profidrive.parameters.codec import ZERO, Attribute, ParameterAddress, Request, RequestId, Response, Values
from pdgw.profinet.rpc import dcerpc
from pdgw.profinet.rpc.client import RecordCall, RecordCaller
from pdgw.profinet.rpc.records import RECORD_GLOBAL, RECORD_LOCAL, RecordBlock
from pdgw.profinet.rpc.server import RecordServer
from tests.support.readers import tshark

R, C = RequestId.REQUEST, RequestId.CHANGE
PREFIX = "pn_io.profidrive.parameter."
U8, U16, U32 = DataType.UNSIGNED8, DataType.UNSIGNED16, DataType.UNSIGNED32
# An odd number of bytes only at the end: tshark 4.0 does not skip the padding after it and reads the next value from it.
TALKS: list[tuple[Request, Response]] = [
    (Request(1, R, 1, (ParameterAddress(965),)), Response(1, R, 1, 1, (Values(U16, (0x329,)),))),
    (
        Request(
            2,
            R,
            0,
            (
                ParameterAddress(947, 0, 8),
                ParameterAddress(0x1018, 3, 1),
                ParameterAddress(922, 0, 0, Attribute.DESCRIPTION),
            ),
        ),
        Response(
            2,
            R,
            0,
            3,
            (
                Values(U16, tuple(range(8))),
                Values(DataType.DOUBLE_WORD, (0x3004A,)),
                Values.error(9),
            ),
        ),
    ),
    (Request(3, C, 5, (ParameterAddress(922),), (Values(DataType.WORD, (9,)),)), Response(3, C, 5, 1)),
    (
        Request(
            4,
            C,
            254,
            (ParameterAddress(0x6083), ParameterAddress(0x607B, 1, 2), ParameterAddress(0x6060)),
            (Values(U32, (300,)), Values(DataType.DOUBLE_WORD, (1, 2)), Values(DataType.BYTE, (3,))),
        ),
        Response(4, C, 254, 3, (ZERO, Values.error(0x0B), Values.error(2, 2))),
    ),
    (Request(255, R, 1, (ParameterAddress(5000),)), Response(255, R, 1, 1, (Values.error(0),))),
    (
        Request(6, R, 1, tuple(ParameterAddress(1000 + n) for n in range(39))),
        Response(6, R, 1, 39, tuple(Values(U8, (n, n + 1)) for n in range(39))),
    ),
    (Request(7, R, 1, (ParameterAddress(60000),)), Response(7, R, 1, 1, (Values(DataType.FLOATING_POINT, (1500.0,)),))),
]


@dataclass
class Answers:
    """Answers each request with what the talk says."""

    pending: list[bytes] = field(default_factory=list)

    def write(self, block: RecordBlock, data: bytes) -> None:
        pass

    def read(self, block: RecordBlock, *, implicit: bool) -> bytes:
        return self.pending.pop(0)


def numbers(text: str) -> list[int]:
    return [int(part, 0) for part in text.split(",") if part]


@tshark.needs_tshark
@pytest.mark.tshark
def test_every_field_in_tshark_has_the_sent_value(tmp_path: Path) -> None:
    talks = [(index, *talk) for index in (RECORD_LOCAL, RECORD_GLOBAL) for talk in TALKS]
    answers = Answers([codec.encode_response(response) for _, _, response in talks])
    server = RecordServer(answers, 4096)
    plc = RecordCaller(UUID(int=99), dcerpc.object_uuid(1, 2, 3), UUID(int=7))
    packets: list[bytes] = []

    def carry(call: RecordCall) -> None:
        for packet in call.packets:
            packets.append(packet)
            packets.extend(server.receive(packet, "plc"))

    for index, request, _ in talks:
        carry(plc.write(0x3A00, 1, 1, index, codec.encode_request(request)))
        carry(plc.read(0x3A00, 1, 1, index))
    capture = tmp_path / "parameters.pcap"
    ports = {0: (50000, 34964), 2: (34964, 50000)}
    wrpcap(
        str(capture),
        [
            Ether()
            / IP(src="127.0.0.1", dst="127.0.0.1")
            / UDP(sport=ports[packet[1]][0], dport=ports[packet[1]][1])
            / packet
            for packet in packets
        ],
    )
    names = [
        "_ws.malformed",
        *(
            PREFIX + name
            for name in (
                "request_reference",
                "request_id",
                "response_id",
                "do",
                "no_of_parameters",
                "attribute",
                "no_of_elems",
                "number",
                "index",
                "format",
                "no_of_values",
                "value_b",
                "value_w",
                "value_dw",
                "value_float",
                "error_num",
                "error_subindex",
            )
        ),
    ]
    rows = tshark.fields(capture, names, ("-E", "occurrence=a"))
    assert len(rows) == 4 * len(talks)
    assert not any(row["_ws.malformed"] for row in rows)
    for place, (_, request, response) in enumerate(talks):
        asked, answered = rows[4 * place], rows[4 * place + 3]

        def read(row: dict[str, str], name: str) -> list[int]:
            return numbers(row[PREFIX + name])

        assert read(asked, "request_reference") == [request.reference]
        assert read(asked, "request_id") == [request.request_id]
        assert read(asked, "do") == [request.do_id]
        assert read(asked, "no_of_parameters") == [len(request.addresses)]
        assert read(asked, "attribute") == [address.attribute for address in request.addresses]
        assert read(asked, "no_of_elems") == [address.elements for address in request.addresses]
        assert read(asked, "number") == [address.pnu for address in request.addresses]
        assert read(asked, "index") == [address.subindex for address in request.addresses]
        assert read(asked, "format") == [item.format.code for item in request.values]
        negative = 0x80 if response.negative else 0
        assert read(answered, "response_id") == [response.request_id | negative]
        assert read(answered, "request_reference") == [request.reference]
        assert read(answered, "do") == [request.do_id]
        assert read(answered, "format") == [item.format.code for item in response.values]
        assert read(answered, "no_of_values") == [len(item.values) for item in response.values]
        for row, items in ((asked, request.values), (answered, response.values)):
            for name, size in (("value_b", 1), ("value_w", 2), ("value_dw", 4)):
                meant = [
                    value
                    for item in items
                    if item.format.size == size and not item.failed and item.format is not DataType.FLOATING_POINT
                    for value in item.values
                ]
                assert read(row, name) == meant, name
        floats = [item.values[0] for item in response.values if item.format is DataType.FLOATING_POINT]
        assert [float(part) for part in answered[PREFIX + "value_float"].split(",") if part] == floats
        errors = [item.values for item in response.values if item.failed]
        assert read(answered, "error_num") == [values[0] for values in errors]
        assert read(answered, "error_subindex") == [values[1] for values in errors if len(values) > 1]
