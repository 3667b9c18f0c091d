"""The endpoint mapper as a real controller and engineering tools ask it; tshark is the independent reader."""

from __future__ import annotations

import struct
from ipaddress import IPv4Address
from pathlib import Path
from uuid import UUID

import pytest

from pdgw.profidrive.errors import ProfidriveError
from pdgw.profinet.rpc import dcerpc, epm
from pdgw.profinet.rpc.dcerpc import PacketType, RejectStatus, RpcHeader
from pdgw.profinet.rpc.epm import EndpointMapper
from pdgw.profinet.rpc.server import RpcServer
from tests.support.readers import tshark, tshark_frames

ADDRESS = IPv4Address("192.168.0.2")
DEVICE = dcerpc.object_uuid(1, 0x0402, 0xFFFF)
NIL_HANDLE = bytes(20)


def lookup(handle: bytes = NIL_HANDLE, little: bool = True, most: int = 1) -> bytes:
    end = "<" if little else ">"
    interface = struct.pack(f"{end}I", 2) + bytes(20)
    return (
        struct.pack(f"{end}II", 0, 1)
        + bytes(16)
        + interface
        + struct.pack(f"{end}I", 1)
        + handle
        + struct.pack(f"{end}I", most)
    )


def mapper() -> EndpointMapper:
    return EndpointMapper(DEVICE, "gateway                   PDGW                     1 V  0  1  0")


@pytest.mark.parametrize("little", [True, False])
def test_a_lookup_lists_mapper_and_device_then_ends(little: bool) -> None:
    service = mapper()
    end = "<" if little else ">"
    objects = []
    handle = NIL_HANDLE
    for _ in range(2):
        answer = service.execute(epm.LOOKUP, lookup(handle, little), ADDRESS, little=little)
        assert isinstance(answer, bytes)
        handle = answer[:20]
        assert handle != NIL_HANDLE
        assert struct.unpack_from(f"{end}I", answer, 20) == (1,)
        objects.append(UUID(bytes_le=answer[36:52]) if little else UUID(bytes=answer[36:52]))
    assert objects == [UUID(int=0), DEVICE]
    last = service.execute(epm.LOOKUP, lookup(handle, little), ADDRESS, little=little)
    assert isinstance(last, bytes)
    assert last[:20] == NIL_HANDLE
    assert struct.unpack_from(f"{end}I", last, len(last) - 4) == (epm.NOT_REGISTERED,)


def test_parallel_lookups_are_independent() -> None:
    service = mapper()
    first, second = (service.execute(epm.LOOKUP, lookup(), ADDRESS, little=True) for _ in range(2))
    assert isinstance(first, bytes)
    assert isinstance(second, bytes)
    assert first[:20] != second[:20]
    for handle in (first[:20], second[:20]):
        answer = service.execute(epm.LOOKUP, lookup(handle), ADDRESS, little=True)
        assert isinstance(answer, bytes)
        assert answer[20] == 1


def test_unfinished_lookups_are_bounded() -> None:
    service = mapper()
    first = service.execute(epm.LOOKUP, lookup(), ADDRESS, little=True)
    assert isinstance(first, bytes)
    for _ in range(1000):
        service.execute(epm.LOOKUP, lookup(), ADDRESS, little=True)
    forgotten = service.execute(epm.LOOKUP, lookup(first[:20]), ADDRESS, little=True)
    assert isinstance(forgotten, bytes)
    assert forgotten[:20] == NIL_HANDLE


def test_seventeenth_parallel_lookup_ends_the_first() -> None:
    for others, known in ((15, True), (16, False)):
        service = mapper()
        first = service.execute(epm.LOOKUP, lookup(), ADDRESS, little=True)
        assert isinstance(first, bytes)
        for _ in range(others):
            service.execute(epm.LOOKUP, lookup(), ADDRESS, little=True)
        answer = service.execute(epm.LOOKUP, lookup(first[:20]), ADDRESS, little=True)
        assert isinstance(answer, bytes)
        assert (answer[:20] == first[:20]) is known


def test_lookup_of_zero_entries_or_after_the_end_gets_none() -> None:
    service = mapper()
    none = service.execute(epm.LOOKUP, lookup(most=0), ADDRESS, little=True)
    nothing = bytes(20) + struct.pack("<4I", 0, 1, 0, 0) + struct.pack("<I", 0x16C9A0D6)
    assert none == nothing
    handle = NIL_HANDLE
    for _ in range(2):
        answer = service.execute(epm.LOOKUP, lookup(handle, most=256), ADDRESS, little=True)
        assert isinstance(answer, bytes)
        handle = answer[:20]
    assert [service.execute(epm.LOOKUP, lookup(handle), ADDRESS, little=True) for _ in range(2)] == [nothing] * 2


def test_request_may_omit_references_and_end_with_padding() -> None:
    shortest = epm.lookup_request()
    assert len(shortest) == 40
    for body in (shortest, lookup() + bytes(9)):
        answer = mapper().execute(epm.LOOKUP, body, ADDRESS, little=True)
        assert isinstance(answer, bytes)
        assert answer[20] == 1


@pytest.mark.parametrize("little", [True, False])
def test_request_and_answer_byte_by_byte(little: bool) -> None:
    service, end = mapper(), "<" if little else ">"
    handle = NIL_HANDLE
    for _ in range(2):
        request = epm.lookup_request(handle, little=little)
        assert request == bytes(16) + handle + struct.pack(f"{end}I", 1)
        answer = service.execute(epm.LOOKUP, request, ADDRESS, little=little)
        assert isinstance(answer, bytes)
        handle, told = epm.lookup_answer(answer, little=little)
    annotation = b"gateway                   PDGW                     1 V  0  1  0"
    tower = bytes.fromhex(
        "0500"
        "1300 0d 0100a0de976cd111827100a02442df7d 0100 0200 0000"
        "1300 0d 045d888aeb1cc9119fe808002b104860 0200 0200 0000"
        "0100 0a 0200 0000"
        "0100 08 0200 8894"
        "0100 09 0400 c0a80002"
    )
    assert told == DEVICE
    assert answer == b"".join(
        (
            struct.pack(f"{end}I", 0) + UUID(int=1).bytes,
            struct.pack(f"{end}4I", 1, 1, 0, 1),
            DEVICE.bytes_le if little else DEVICE.bytes,
            struct.pack(f"{end}3I", 4, 0, len(annotation) + 1) + annotation + bytes(-len(annotation) % 4 or 4),
            struct.pack(f"{end}2I", len(tower), len(tower)) + tower + bytes(-len(tower) % 4),
            struct.pack(f"{end}I", 0),
        )
    )
    last = service.execute(epm.LOOKUP, epm.lookup_request(handle, little=little), ADDRESS, little=little)
    assert isinstance(last, bytes)
    assert epm.lookup_answer(last, little=little) == (NIL_HANDLE, None)
    with pytest.raises(ProfidriveError, match="endpoint mapper"):
        epm.lookup_answer(last[:35], little=little)
    assert epm.lookup_answer(answer[:51], little=little) == (handle, None), "cut short"


def test_other_operations_and_short_requests_are_rejected() -> None:
    assert mapper().execute(3, lookup(), ADDRESS, little=True) is RejectStatus.OPERATION_OUT_OF_RANGE
    assert mapper().execute(epm.LOOKUP, bytes(39), ADDRESS, little=True) is RejectStatus.PROTOCOL_ERROR


@tshark.needs_tshark
@pytest.mark.tshark
def test_tshark_reads_the_entries(tmp_path: Path) -> None:
    service = mapper()

    def execute(header: RpcHeader, body: bytes, source: tuple[str, int], now: int) -> bytes | RejectStatus:
        return service.execute(header.operation, body, ADDRESS, little=header.little_endian)

    server: RpcServer[tuple[str, int]] = RpcServer({epm.INTERFACE: execute}, 4096)
    plc, device = ("192.168.0.1", 50000), ("192.168.0.2", 34964)
    frames = []
    for little, activity in ((True, UUID(int=77)), (False, UUID(int=78))):
        handle = NIL_HANDLE
        for sequence in range(3):
            header = RpcHeader(
                PacketType.REQUEST, UUID(int=0), activity, sequence, epm.LOOKUP, *epm.INTERFACE, little_endian=little
            )
            packet = dcerpc.encode_packet(header, lookup(handle, little))
            (answer,) = server.receive(packet, plc)
            handle = dcerpc.decode_packet(answer)[1][:20]
            frames += [tshark_frames.datagram(packet, plc, device), tshark_frames.datagram(answer, device, plc)]
    names = ["epm.annotation", "epm.proto.ip", "epm.proto.udp_port", "epm.uuid", "epm.num_ents", "epm.rc"]
    rows = tshark_frames.read(frames, tmp_path / "epm.pcap", names, every=True)
    for first, second, last in (rows[1:6:2], rows[7::2]):
        assert [row["epm.num_ents"] for row in (first, second, last)] == ["1", "1", "0"]
        assert first["epm.annotation"].startswith("gateway ")
        assert second["epm.proto.ip"] == "192.168.0.2"
        assert second["epm.proto.udp_port"] == "34964"
        assert "dea00001-6c97-11d1-8271-00a02442df7d" in second["epm.uuid"]
        assert int(last["epm.rc"], 0) == epm.NOT_REGISTERED
