"""Records around the parameter channel: I&M, places and relationships, what a response is of."""

from __future__ import annotations

import struct
from uuid import UUID, uuid4

import pytest

from pdgw.ds301.aborts import ABORT_TEXTS, Abort
from pdgw.gateway.daemon import Daemon
from pdgw.gateway.errors import GatewayError
from pdgw.profidrive.parameters.codec import ParameterAddress, decode_response
from pdgw.profidrive.parameters.codec import ParameterErrorNumber as Number
from pdgw.profinet.rpc import identification
from pdgw.profinet.rpc.client import RecordCaller, RecordResult
from pdgw.profinet.rpc.dcerpc import object_uuid
from pdgw.tools.client.udp import ParameterClient
from tests.support.gateways.daemon import axis
from tests.support.gateways.daemon import client as client_of
from tests.support.gateways.parameters import error, gateway, value


def read_anywhere(client: ParameterClient, api: int, *, implicit: bool = False) -> RecordResult:
    caller = RecordCaller(uuid4(), object_uuid(1, 0, 0))
    return client.call(caller.read(api, 1, 1, identification.INDEX, implicit=implicit))


def test_identification_records_are_read_and_written_and_survive(shared: tuple[Daemon, ParameterClient]) -> None:
    daemon, client = shared
    assert client.read_record(identification.INDEX)[:6] == bytes.fromhex("00 20 00 38 01 00")
    assert read_anywhere(client, identification.PROFILE_ID, implicit=True).data == client.read_record(
        identification.INDEX
    )
    assert read_anywhere(client, 5).status.text.startswith("invalid area")
    record = identification.encode_im(1, (b"press 4", b"hall B"))
    client.write_record(identification.INDEX + 1, record)
    assert client.read_record(identification.INDEX + 1) == record
    signature = identification.encode_im(4, (bytes(range(54)),))
    client.write_record(identification.INDEX + 4, signature)
    assert client.read_record(identification.INDEX + 4) == signature
    assert daemon.store.parameters.im1_function == "press 4"
    for index, data, reason in (
        (identification.INDEX, record, "access denied"),
        (identification.INDEX + 1, record[:-1], "write length"),
        (0x1234, record, "invalid index"),
        (0xB02F, bytes(4097), "write length"),
    ):
        with pytest.raises(GatewayError, match=reason):
            client.write_record(index, data)


def test_places_and_relationships_that_do_not_exist_are_refused(shared: tuple[Daemon, ParameterClient]) -> None:
    address = shared[1].address
    for options, reason in (
        ({"slot": 2}, "invalid slot"),
        ({"subslot": 3}, "invalid slot"),
        ({"caller": RecordCaller(uuid4(), object_uuid(1, 0, 0), UUID(int=1))}, "AR UUID unknown"),
    ):
        with client_of(shared[0], address, 1, **options) as client, pytest.raises(GatewayError, match=reason):
            client.read_record(identification.INDEX)
    with pytest.raises(GatewayError, match="state conflict"):
        shared[1].read_record(0xB02F)


def test_local_access_means_the_axis_of_the_slot() -> None:
    with gateway(axis(5) + axis(9)) as (daemon, client):
        for slot, do_id, expected in ((1, 0, 5), (1, 5, 5), (2, 9, 9), (2, 0, 9)):
            with client_of(daemon, client.address, do_id, slot=slot, local=True) as local:
                assert value(local, 975, 7, 1).values == (expected,)
        with client_of(daemon, client.address, 9, slot=1, local=True) as local:
            assert error(value(local, 975, 7, 1)) == Number.DO_DOES_NOT_EXIST
        with client_of(daemon, client.address, 0, slot=0) as device:
            assert value(device, 978, 0, 2).values == (5, 9)
            assert value(device, 964, 5, 1).values == (2,)
            assert error(value(device, 922)) == Number.IMPERMISSIBLE_PNU, "which of the two axes?"


def test_a_response_that_does_not_fit_says_so_and_the_rest_is_there(shared: tuple[Daemon, ParameterClient]) -> None:
    _, client = shared
    addresses = [ParameterAddress(949, 0, 64)] * 20
    answers = client.request(addresses)
    failed = [answer.failed for answer in answers]
    assert failed == [False] * 15 + [True] * 5
    assert {error(answer) for answer in answers[15:]} == {Number.RESPONSE_TOO_LONG}


def test_a_response_has_the_reference_and_do_of_its_request(shared: tuple[Daemon, ParameterClient]) -> None:
    _, client = shared
    for reference in (1, 255):
        raw = client.exchange(bytes((reference, 1, 1, 1)) + struct.pack(">BBHH", 0x10, 0, 965, 0))
        response = decode_response(raw)
        assert (response.reference, response.do_id) == (reference, 1)


def test_aborts_are_complete() -> None:
    assert set(Abort) == set(ABORT_TEXTS)
