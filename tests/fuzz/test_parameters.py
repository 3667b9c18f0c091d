"""Mutated parameter requests, responses and RPC packets: only the codec's error, only valid answers."""

from __future__ import annotations

import contextlib
from typing import ClassVar
from uuid import UUID

from hypothesis import given
from hypothesis import strategies as st

from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.parameters.catalogue import PARAMETERS, ParameterSpec
from pdgw.profidrive.parameters.codec import (
    Attribute,
    ParameterAddress,
    ParameterErrorNumber,
    ParameterRefused,
    Request,
    RequestId,
    Values,
    decode_request,
    decode_response,
    encode_request,
)
from pdgw.profidrive.parameters.model import BoundParameter, Parameter, answer
from pdgw.profinet.rpc import dcerpc
from pdgw.profinet.rpc.client import RecordCaller
from pdgw.profinet.rpc.records import RecordBlock
from pdgw.profinet.rpc.server import RecordServer
from tests.fuzz.test_frames import mutated

_NUMBERS = [item for item in DataType if item.char and item is not DataType.ERROR and not item.is_float]


def _zero(spec: ParameterSpec) -> BoundParameter:
    if spec.array:
        return BoundParameter(spec, lambda: [0] * 16)
    text = spec.type in {DataType.VISIBLE_STRING, DataType.OCTET_STRING}
    return BoundParameter(spec, lambda: b"abc" if text else 0, (lambda _: None) if spec.writable else None)


class Device:
    """Every parameter of the profile, all zero."""

    parameters: ClassVar[dict[int, Parameter]] = {pnu: _zero(spec) for pnu, spec in PARAMETERS.items()}

    def parameter(self, pnu: int) -> Parameter:
        if pnu not in self.parameters:
            raise ParameterRefused(ParameterErrorNumber.IMPERMISSIBLE_PNU)
        return self.parameters[pnu]

    def check_writable(self, pnu: int) -> None:
        """Everything is."""


@st.composite
def values(draw: st.DrawFn) -> Values:
    data_type = draw(st.sampled_from([*_NUMBERS, DataType.VISIBLE_STRING]))
    if not data_type.char:
        return Values(data_type, draw(st.binary(max_size=20)))
    low, high = data_type.integer_range
    return Values(data_type, tuple(draw(st.lists(st.integers(low, high), max_size=5))))


@st.composite
def requests(draw: st.DrawFn) -> Request:
    pnus = st.one_of(st.sampled_from(sorted(PARAMETERS)), st.integers(1, 0xFFFF))
    addresses = draw(
        st.lists(
            st.builds(ParameterAddress, pnus, st.integers(0, 20), st.integers(0, 20), st.sampled_from(list(Attribute))),
            min_size=1,
            max_size=39,
        )
    )
    service = draw(st.sampled_from(list(RequestId)))
    areas = [draw(values()) for _ in addresses] if service is RequestId.CHANGE else []
    return Request(draw(st.integers(1, 255)), service, draw(st.integers(0, 3)), tuple(addresses), tuple(areas))


@given(requests(), st.data())
def test_every_mutated_request_has_a_valid_answer_or_none(request: Request, data: st.DataObject) -> None:
    raw = data.draw(mutated(encode_request(request)))
    device = Device()
    response = answer(raw, lambda do_id: device if do_id < 2 else None, 240)
    if response is None:
        assert len(raw) < 4
        return
    assert len(response) <= 240
    assert response[0] == raw[0]
    assert response[2] == raw[2]
    with contextlib.suppress(ProfidriveError):
        parsed = decode_request(raw)
        decoded = decode_response(response)
        assert decoded.count == len(parsed.addresses)
        assert decoded.request_id is parsed.request_id


@given(requests(), st.data())
def test_mutated_responses_raise_the_codec_s_error_only(request: Request, data: st.DataObject) -> None:
    device = Device()
    response = answer(encode_request(request), lambda _: device, 240)
    assert response is not None
    decode_response(response)
    with contextlib.suppress(ProfidriveError):
        decode_response(data.draw(mutated(response)))


class Memory:
    """A record that holds what was written."""

    record = b""

    def read(self, block: RecordBlock, *, implicit: bool) -> bytes:
        return self.record

    def write(self, block: RecordBlock, data: bytes) -> None:
        self.record = data


@given(st.binary(max_size=3000), st.data())
def test_mutated_rpc_packets_are_answered_with_rpc_packets_or_not_at_all(content: bytes, data: st.DataObject) -> None:
    server = RecordServer[object](Memory(), 2048)
    caller = RecordCaller(UUID(int=7), dcerpc.object_uuid(1, 2, 3))
    calls = [caller.write(0, 1, 1, 0xB02F, content), caller.read(0, 1, 1, 0xB02F)]
    for call in calls:
        for packet in call.packets:
            for reply in server.receive(data.draw(mutated(packet)), "plc"):
                dcerpc.decode_packet(reply)
                with contextlib.suppress(ProfidriveError):
                    call.receive(data.draw(mutated(reply)))
