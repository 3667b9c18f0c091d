"""Records: of several callers, around the parameter channel (I&M, places, relationships), and under a flood."""

from __future__ import annotations

import struct
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from ipaddress import IPv4Network
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast
from uuid import UUID, uuid4

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.base.durations import MS
from pdgw.ds301.aborts import ABORT_TEXTS, Abort
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.store import DeviceParameters, ParameterStore
from pdgw.gateway.base.udp import Address
from pdgw.gateway.client.udp import ParameterClient
from pdgw.gateway.configuration.environment import ParametersConfig, TransportConfig
from pdgw.gateway.configuration.file import parse_config
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.parameters.manager import ParameterManager
from pdgw.gateway.parameters.records import CallerRecords, Records
from pdgw.profidrive.parameters.codec import ParameterAddress, decode_response
from pdgw.profidrive.parameters.error_numbers import ParameterErrorNumber as Number
from pdgw.profinet.blocks import record_blocks as blocks
from pdgw.profinet.rpc import dcerpc, identification
from pdgw.profinet.rpc.client import RecordCaller, RecordResult
from pdgw.profinet.rpc.dcerpc import object_uuid
from pdgw.profinet.rpc.records import NIL, RECORD_GLOBAL, AccessError, BlockType, RecordBlock, RecordRefused
from tests.support.gateways.daemon import axis, configuration, drive_of, record_server, running, serving, world_of
from tests.support.gateways.daemon import client as client_of
from tests.support.gateways.parameters import error, gateway, value
from tests.support.gateways.profinet_daemon import Plant, plant
from tests.support.gateways.profinet_daemon import configuration as profinet_configuration
from tests.support.wire.profinet import PLC_IP

# -- several callers: whose answer it is, who may write, and how much is kept -------------------------------------


HERE = ("127.0.0.1", 40000)
READ_P965 = bytes.fromhex("02 01 00 01 10 00 03 C5 00 00")
WRITE_P922 = bytes.fromhex("03 02 01 01 10 00 03 9A 00 00 42 01 00 09")


class Manager:
    """Takes requests; the test answers them."""

    slots = (0, 1)

    def __init__(self) -> None:
        self.asked: list[tuple[bytes, Future[bytes | None]]] = []

    def submit(self, data: bytes, slot_do: int | None = None, host: str | None = None) -> Future[bytes | None]:
        future: Future[bytes | None] = Future()
        self.asked.append((data, future))
        return future


def records(*writers: str, everybody: bool = True) -> tuple[Records, Manager]:
    manager = Manager()
    networks = None if everybody else [IPv4Network(item) for item in writers]
    store = ParameterStore(None, lambda _: None)
    transport = TransportConfig()
    daemon = SimpleNamespace(config=SimpleNamespace(transport=transport), store=store, update_store=store.update)
    return Records(cast(Daemon, daemon), cast(ParameterManager, manager), NIL, networks), manager


def block(kind: BlockType, index: int = RECORD_GLOBAL, slot: int = 0) -> RecordBlock:
    return RecordBlock(kind, 1, NIL, 0, slot, 1, index, 4096)


def ask(caller: CallerRecords, data: bytes = READ_P965, index: int = RECORD_GLOBAL) -> None:
    caller.write(block(BlockType.WRITE_REQUEST, index), data)


def fetch(caller: CallerRecords) -> bytes:
    return caller.read(block(BlockType.READ_REQUEST), implicit=False)


def refusal(action: Callable[[], Any]) -> int:
    with pytest.raises(RecordRefused) as refused:
        action()
    return refused.value.code1


@given(st.lists(st.tuples(st.sampled_from(["ask", "answer", "fetch"]), st.integers(0, 3)), max_size=60))
def test_every_caller_gets_the_answers_to_its_own_requests_and_no_other(events: list[tuple[str, int]]) -> None:
    """Four callers: two addresses, two activities at each."""
    served, manager = records()
    callers = [served.of(("127.0.0.1", 40000 + number // 2), UUID(int=number % 2)) for number in range(4)]
    waiting: dict[int, int] = {}
    for count, (action, number) in enumerate(events):
        caller = callers[number]
        mine = waiting.get(number)
        done = mine is not None and manager.asked[mine][1].done()
        if action == "ask":
            if all(future.done() for _, future in manager.asked):
                ask(caller, bytes((count, 1, number, 1)))
                waiting[number] = len(manager.asked) - 1
            else:
                assert refusal(lambda: ask(caller)) == AccessError.STATE_CONFLICT  # noqa: B023
        elif action == "answer":
            if mine is not None and not done:
                data, future = manager.asked[mine]
                future.set_result(b"answer to " + data)
        elif done:
            assert mine is not None
            assert fetch(caller) == b"answer to " + manager.asked[mine][0]
            del waiting[number]
        else:
            assert refusal(lambda: fetch(caller)) == AccessError.STATE_CONFLICT  # noqa: B023


def test_answers_that_are_not_fetched_do_not_fill_the_memory() -> None:
    served, manager = records()
    for number in range(1000):
        ask(served.of(HERE, UUID(int=number)))
        manager.asked[-1][1].set_result(b"x")
    assert len(served._requests) <= 32


def test_while_a_request_is_in_work_another_one_at_its_place_is_refused() -> None:
    served, manager = records()
    ask(served.of(HERE, UUID(int=1)))
    other = served.of(HERE, UUID(int=2))
    assert refusal(lambda: ask(other)) == AccessError.STATE_CONFLICT
    other.write(block(BlockType.WRITE_REQUEST, slot=1), READ_P965)
    manager.asked[0][1].set_result(b"mine")
    assert refusal(lambda: fetch(other)) == AccessError.STATE_CONFLICT
    ask(other)
    assert fetch(served.of(HERE, UUID(int=1))) == b"mine"


@pytest.mark.parametrize(
    ("host", "may_write"),
    [("192.168.0.10", True), ("192.168.0.70", True), ("192.168.0.80", False), ("127.0.0.1", False)],
)
def test_only_clients_in_write_from_write_parameters_and_all_read(host: str, may_write: bool) -> None:
    served, manager = records("192.168.0.10", "192.168.0.64/28", everybody=False)
    caller = served.of((host, 1), NIL)
    ask(caller)
    manager.asked[-1][1].set_result(b"value")
    assert fetch(caller) == b"value"
    im1 = identification.encode_im(1, tuple(b"x" for _ in identification.TEXT_FIELDS[1]))
    for data, index in ((WRITE_P922, RECORD_GLOBAL), (im1, identification.INDEX + 1)):
        if may_write:
            ask(caller, data, index)
        else:
            assert refusal(lambda: ask(caller, data, index)) == AccessError.ACCESS_DENIED  # noqa: B023


@pytest.mark.parametrize("request_id", [0, 2, 3, 0x82, 0xFF])
def test_what_is_not_a_read_request_counts_as_a_write(request_id: int) -> None:
    served, manager = records(everybody=False)
    data = bytes((1, request_id, 1, 1))
    assert refusal(lambda: ask(served.of(HERE, NIL), data)) == AccessError.ACCESS_DENIED
    assert manager.asked == []


def test_without_a_list_only_clients_on_the_machine_write() -> None:
    local = configuration(axis(1)).transport.listen
    beyond = configuration(axis(1), transport='listen = "192.168.0.5"\npeer = "192.168.0.10"').transport.listen
    assert ParametersConfig().writers(local) is None
    assert ParametersConfig().writers(beyond) == ()


def test_an_invalid_network_is_rejected_with_its_place() -> None:
    with pytest.raises(GatewayError, match=r"x.toml:8: .*write_from.*192.168.0.300"):
        parse_config(
            '[can]\ninterface = "virtual"\n[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = 1\n[parameters]\n'
            'write_from = ["192.168.0.300"]\n',
            "x.toml",
        )


@pytest.mark.parametrize("listen", ["0.0.0.0", "192.168.0.5"])
def test_beyond_loopback_the_peer_is_mandatory_and_the_message_says_why(listen: str) -> None:
    with pytest.raises(
        GatewayError, match=rf"peer is missing: other computers can reach listen = {listen}, .* control the drives"
    ):
        configuration(axis(1), transport=f'listen = "{listen}"')
    configuration(axis(1), transport=f'listen = "{listen}"\npeer = "192.168.0.10"')


def test_im0_answers_at_every_submodule_and_im1_to_im4_at_subslot_1() -> None:
    served, _ = records()
    caller = served.of(HERE, NIL)

    def ask_at(slot: int, subslot: int, number: int) -> bytes:
        place = RecordBlock(BlockType.READ_REQUEST, 1, NIL, 0, slot, subslot, identification.INDEX + number, 4096)
        return caller.read(place, implicit=True)

    device = identification.decode_im0(ask_at(0, 1, 0))
    assert device.supported == 0b11110
    for place, supported in (((1, 1), 0b11110), ((0, 0x8000), 0), ((0, 0x8001), 0), ((1, 2), 0)):
        assert identification.decode_im0(ask_at(*place, 0)) == replace(device, supported=supported)
    for place in ((0, 2), (1, 0x8000), (1, 3), (2, 1)):
        assert refusal(lambda: ask_at(*place, 0)) == AccessError.INVALID_SLOT  # noqa: B023
    assert refusal(lambda: ask_at(1, 2, 1)) == AccessError.INVALID_INDEX


@pytest.mark.parametrize("subslot", [1, 2])
@pytest.mark.parametrize("index", [0xB02E, 0xB02F, 0x2F])
def test_every_parameter_record_is_served_at_access_point_and_telegram(subslot: int, index: int) -> None:
    """Older function blocks use record 47 and the hardware identifier of the telegram."""
    served, _ = records()
    caller = served.of(HERE, NIL)
    block = RecordBlock(BlockType.WRITE_REQUEST, 1, NIL, 0, 1, subslot, index, 10)
    caller.write(block, bytes.fromhex("010101011001039A0000"))
    assert refusal(lambda: caller.read(block, implicit=False)) == AccessError.STATE_CONFLICT


def test_a_refused_record_is_in_the_log_once(caplog: pytest.LogCaptureFixture) -> None:
    served, _ = records()
    caller = served.of(HERE, NIL)
    for subslot, index in ((3, 0xB02F), (3, 0xB02F), (1, 0x1234)):
        block = RecordBlock(BlockType.READ_REQUEST, 1, NIL, 0, 1, subslot, index, 240)
        refusal(lambda: caller.read(block, implicit=False))  # noqa: B023
    assert [record.getMessage() for record in caplog.records] == [
        f"record B02Fh of slot 1, subslot 3 for {HERE[0]} refused: invalid slot",
        f"record 1234h of slot 1, subslot 1 for {HERE[0]} refused: invalid index",
    ]


@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_an_im_record_of_a_wrong_length_is_refused_as_such(number: int) -> None:
    served, _ = records()
    caller = served.of(HERE, NIL)
    index = identification.INDEX + number
    right = caller.read(block(BlockType.READ_REQUEST, index), implicit=False)
    for data in (b"", right[:-1], right + b" "):
        refused = refusal(lambda: caller.write(block(BlockType.WRITE_REQUEST, index), data))  # noqa: B023
        assert refused == AccessError.WRITE_LENGTH
    caller.write(block(BlockType.WRITE_REQUEST, index), right)


@pytest.mark.parametrize("delay_ms", [11, 23, 35, 60, 80])
def test_an_answer_is_fetched_within_10_ms_of_being_ready(delay_ms: int) -> None:
    with serving(configuration(axis(1))) as (daemon, client):
        elapsed = []
        for delay in (1, delay_ms):
            drive_of(daemon).do(lambda node, delay=delay: node.start_fault("slow-sdo", delay_ms=delay))
            began = daemon.loop.now()
            client.request([ParameterAddress(0x6041, 0, 1)])
            elapsed.append(daemon.loop.now() - began)
        fast, slow = elapsed
        assert slow - fast <= (delay_ms + 10) * MS


# -- I&M, places and relationships --------------------------------------------------------------------------------


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
    assert daemon.store.parameters.objects[1].im1_function == "press 4"
    for index, data, reason in (
        (identification.INDEX, record, "access denied"),
        (identification.INDEX + 1, record[:-1], "write length"),
        (0x1234, record, "invalid index"),
        (0xB02F, bytes(4097), "write length"),
    ):
        with pytest.raises(GatewayError, match=reason):
            client.write_record(index, data)


def test_each_place_with_writable_identification_has_its_own(tmp_path: Path) -> None:
    """F840h, IM_Supported of I&M0, and the memory agree; the memory survives a restart, and a reset clears all of it."""
    config = profinet_configuration(axis(1) + axis(2), tmp_path / "store.json")

    def ask(site: Plant, slot: int, subslot: int, index: int) -> bytes:
        kind, api = BlockType.READ_REQUEST, identification.PROFILE_ID if slot else 0
        block = RecordBlock(kind, 1, NIL, api, slot, subslot, index, 4096)
        return site.link.device.cm.records.read(None, block, "192.168.0.9", site.loop.now())

    def text_of(site: Plant, slot: int, number: int) -> tuple[bytes, ...]:
        return tuple(item.rstrip() for item in identification.decode_im(number, ask(site, slot, 1, 0xAFF0 + number)))

    with plant(config) as site:
        filters = ask(site, 0, 1, 0xF840)
        listed = blocks.ImFilterSubmodules.decode(filters[: 4 + int.from_bytes(filters[2:4], "big")])
        places = {(slot.slot, item.subslot) for api in listed.apis for slot in api.slots for item in slot.submodules}
        everything = [
            (slot, subslot) for slot, module in site.link.device.model.modules.items() for subslot in module.submodules
        ]
        supported = {place: identification.decode_im0(ask(site, *place, 0xAFF0)).supported for place in everything}
        assert {place for place, bits in supported.items() if bits} == places == {(0, 1), (1, 1), (2, 1)}
        site.connect()
        handler = site.link._records_for(PLC_IP)

        def write() -> None:
            for slot in range(3):
                for number in (1, 3):
                    fields = (b"slot %d" % slot,) * len(identification.TEXT_FIELDS[number])
                    record = identification.encode_im(number, fields)
                    block = RecordBlock(BlockType.WRITE_REQUEST, 1, NIL, 0, slot, 1, 0xAFF0 + number, len(record))
                    handler.write(block, record)

        task = site.loop.spawn(write, "writes")
        site.until(task.done.is_set, "writes")
        assert task.error is None
    with plant(config) as site:
        for slot in range(3):
            assert text_of(site, slot, 1) == (b"slot %d" % slot,) * 2
            assert text_of(site, slot, 3) == (b"slot %d" % slot,)
        site.daemon.store.update(DeviceParameters.reset_station)
        assert {text_of(site, slot, number) for slot in range(3) for number in (1, 3)} == {(b"", b""), (b"",)}


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


# -- a flood, served by budget beside everything else on the loop -------------------------------------------------


FLOOD = 200
AT_ONCE = 16
"""Datagrams the server takes from the kernel before it has served them."""


def test_a_flooded_record_port_takes_few_datagrams_and_serves_one_a_slice() -> None:
    with running(configuration(axis(1))) as daemon:
        server, loop, network = record_server(daemon), daemon.loop, world_of(daemon).network
        served: list[int] = []
        taken, slices, most = 0, 0, 0
        take: Callable[[], tuple[bytes, Address] | None] = server.port.receive
        answer = server.server.receive

        def taking() -> tuple[bytes, Address] | None:
            nonlocal taken, most
            found = take()
            taken += found is not None
            most = max(most, taken - len(served))
            return found

        def answering(data: bytes, source: Address, now: int = 0) -> list[bytes]:
            served.append(slices)
            loop.add_slice(other)
            return answer(data, source, now)

        def other() -> None:
            nonlocal slices
            slices += 1

        server.port.receive = taking  # type: ignore[method-assign]
        server.server.receive = answering  # type: ignore[method-assign]
        unknown_sender = network.open("stranger", 0, "flood")
        call = RecordCaller(UUID(int=9), dcerpc.object_uuid(1, 1, 1)).read(0, 0, 1, 0xAFF0, implicit=True)
        for _ in range(FLOOD):
            unknown_sender.send(call.packets[0], server.address)
        world_of(daemon).loop.run_for(200 * MS)
    assert len(served) == FLOOD
    assert most <= AT_ONCE
    assert all(later > earlier for earlier, later in pairwise(served)), "others go on in between"
