"""Damaged frames, parameter requests, RPC packets and CAN frames: the gateway keeps serving correct clients.

``make fuzz INPUTS=...`` sends millions of them.
"""

from __future__ import annotations

import contextlib
import random
from collections.abc import Iterator
from typing import ClassVar
from uuid import UUID

import pytest

from pdgw.base.durations import MS
from pdgw.ds301.communication import EMCY, ERROR_CONTROL, NMT, SDO_RESPONSE, SYNC, TIME
from pdgw.ds301.pdo import PdoDirection
from pdgw.dsp402.states import State, state_of
from pdgw.gateway.links.cyclic import CyclicEndpoint
from pdgw.gateway.links.new_frames import Verdict
from pdgw.peers.drive import SimulatedDriveNode
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.frame import RtFrame
from pdgw.profidrive.parameters.catalogue import PARAMETERS, ParameterSpec
from pdgw.profidrive.parameters.codec import (
    Attribute,
    ParameterAddress,
    Request,
    RequestId,
    Values,
    decode_request,
    decode_response,
    encode_request,
)
from pdgw.profidrive.parameters.error_numbers import ParameterErrorNumber, ParameterRefused
from pdgw.profidrive.parameters.model import BoundParameter, Parameter, answer
from pdgw.profidrive.telegrams import telegram
from pdgw.profinet.rpc import dcerpc
from pdgw.profinet.rpc.client import RecordCaller, RecordResult
from pdgw.profinet.rpc.records import RecordBlock
from pdgw.profinet.rpc.server import RecordServer
from pdgw.tools.decoder.frames.engine import Decoder, Packet
from pdgw.tools.decoder.frames.records import LinkType
from pdgw.tools.decoder.view.render import record_line
from tests.decoder.frames.profinet.test_profinet import examples as profinet_packets
from tests.fuzz.amount import INPUTS, SEED, damage
from tests.support.gateways.daemon import Plc, axis, configuration, drive_of, exchanging, running, until, world_of
from tests.support.readers import captures

CYCLE = 4 * MS
PLC, UNKNOWN_SENDER = ("10.0.0.1", 40000), ("10.0.0.9", 40000)
TELEGRAMS = [telegram(number) for number in (1, 9, 111)]
ENCODER = "[[encoder]]\ndo_id = 2\nnode_id = 2\ntelegram = 81\nsimulate = true\n"
RECONNECT = 12
"""Frames after which a PLC that sends in order again is connected."""


@pytest.fixture
def chance() -> random.Random:
    return random.Random(SEED)


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


class Memory:
    """A record with the data that was written."""

    record = b""

    def read(self, block: RecordBlock, *, implicit: bool) -> bytes:
        return self.record

    def write(self, block: RecordBlock, data: bytes) -> None:
        self.record = data


def requests() -> Iterator[bytes]:
    """A request of each service and attribute, for one and for many parameters."""
    known = sorted(PARAMETERS)
    values = (Values(DataType.UNSIGNED16, (1, 2)), Values(DataType.VISIBLE_STRING, b"abc"), Values(DataType.N4, (-1,)))
    for number in (1, 5, 39):
        pnus = [known[place % len(known)] if place % 2 else 900 + place * 7 % 90 for place in range(number)]
        for attribute in Attribute:
            addresses = tuple(ParameterAddress(pnu, place % 3, place, attribute) for place, pnu in enumerate(pnus))
            yield encode_request(Request(1 + number, RequestId.REQUEST, 1, addresses))
            written = tuple(values[place % len(values)] for place in range(number))
            yield encode_request(Request(1 + number, RequestId.CHANGE, 1, addresses, written))


def test_damaged_cyclic_frames_at_most_stop_the_axis(chance: random.Random) -> None:
    plc = PlcEndpoint(TELEGRAMS, CYCLE)
    endpoint = CyclicEndpoint(TELEGRAMS, cycle_ns=CYCLE)
    actuals = [(0,) * len(item.actuals.names) for item in TELEGRAMS]
    now, given = 0, 0
    while given < INPUTS:
        for _ in range(RECONNECT):
            now += CYCLE
            verdict = endpoint.receive(bytes(plc.build(now)), PLC, now)
            endpoint.poll(now)
        assert verdict is Verdict.ACCEPTED
        for _ in range(100):
            now += chance.choice((0, MS, CYCLE, 3 * CYCLE))
            source = chance.choice((PLC, UNKNOWN_SENDER))
            counted = sum(endpoint.counts.frames.values())
            verdict = endpoint.receive(damage(bytes(plc.build(now)), chance), source, now)
            assert sum(endpoint.counts.frames.values()) == counted + 1
            assert (
                source is PLC
                or not endpoint.connected
                or endpoint.peer == UNKNOWN_SENDER
                or verdict is not Verdict.ACCEPTED
            )
            endpoint.poll(now)
            back, counted = (
                damage(bytes(endpoint.build(actuals, [True] * len(actuals))), chance),
                sum(plc.counters.values()),
            )
            plc.receive(back)
            assert sum(plc.counters.values()) == counted + 1
            with contextlib.suppress(ProfidriveError):
                RtFrame.decode(back)
            given += 1
        now += 10 * CYCLE
        endpoint.poll(now)
        assert all(values is None for values in endpoint.setpoints), "nobody sends"


def test_damaged_parameter_requests_have_a_valid_answer_or_none(chance: random.Random) -> None:
    device = Device()
    originals = list(requests())
    for _ in range(INPUTS):
        raw = damage(chance.choice(originals), chance)
        response = answer(raw, lambda do_id: device if do_id < 2 else None, 240)
        if response is None:
            assert len(raw) < 4
            continue
        assert len(response) <= 240
        assert (response[0], response[2]) == (raw[0], raw[2])
        if raw[1] not in set(RequestId):
            assert response[1] == 0x80, "a request ID that is not known"
            continue
        decoded = decode_response(response)
        with contextlib.suppress(ProfidriveError):
            parsed = decode_request(raw)
            assert (decoded.count, decoded.request_id) == (len(parsed.addresses), parsed.request_id)
        with contextlib.suppress(ProfidriveError):
            decode_response(damage(response, chance))


def test_damaged_record_calls_leave_the_server_to_others(chance: random.Random) -> None:
    server = RecordServer(Memory(), 2048)
    caller = RecordCaller(UUID(int=7), dcerpc.object_uuid(1, 2, 3))
    calls = [caller.write(0, 1, 1, 0xB02F, bytes(3000)), caller.read(0, 1, 1, 0xB02F)]
    packets = [packet for call in calls for packet in call.packets]
    for _ in range(INPUTS):
        for reply in server.receive(damage(chance.choice(packets), chance), "unknown"):
            dcerpc.decode_packet(reply)
            with contextlib.suppress(ProfidriveError):
                chance.choice(calls).receive(damage(reply, chance))
    other = RecordCaller(UUID(int=8), dcerpc.object_uuid(1, 2, 3))
    call = other.write(0, 1, 1, 0xB02F, b"whole")
    replies = [reply for packet in call.packets for reply in server.receive(packet, "plc")]
    assert isinstance(call.receive(replies[-1]), RecordResult)


def test_damaged_packets_are_records(chance: random.Random) -> None:
    known = captures.cyclic_packets(2) + captures.parameter_packets([(bytes(20), bytes(8))]) + profinet_packets()
    decoder = Decoder()
    for number in range(1, INPUTS + 1):
        packet = Packet(number, number, LinkType.ETHERNET, "", damage(chance.choice(known), chance))
        assert record_line(decoder.decode(packet), 0)


def test_any_can_frames_leave_a_simulated_drive_in_a_state(chance: random.Random) -> None:
    node = SimulatedDriveNode(1, lambda *_: None)
    node.start(0)
    node.receive(0, b"\x01\x01", 0)
    for now in range(0, INPUTS * 5 * MS, 5 * MS):
        node.receive(chance.randrange(0x800), chance.randbytes(chance.randrange(9)), now)
        node.poll(now)
        assert state_of(node.model.statusword) is not None


def test_any_can_frames_never_start_a_drive(chance: random.Random) -> None:
    """All that a node may send, with any bytes, while the PLC sends OFF: the gateway continues, the drive stays off."""
    kinds = [NMT, SYNC, TIME]
    for node in (1, 2, 9):
        kinds += [EMCY + node, ERROR_CONTROL + node, SDO_RESPONSE + node]
        kinds += [PdoDirection.TPDO.cob_id(number, node) for number in (1, 2, 3, 4)]
    with running(configuration(axis(1) + ENCODER)) as daemon:
        plc = Plc(daemon, [1, 81])
        plc.endpoint.set(0, {"STW1": 0x047E})
        plc.until(lambda: plc.state() == 0x01, "ready")
        world, port = world_of(daemon), daemon.networks["can"]
        with exchanging(plc):
            for number in range(INPUTS):
                port.on_frame(
                    chance.choice(kinds), chance.randbytes(chance.choice((0, 1, 2, 4, 6, 8, 8, 8))), port.loop.now()
                )
                if number % 50 == 0:
                    world.loop.run_for(2 * MS)
                    assert drive_of(daemon).model.state is not State.OPERATION_ENABLED
            until(daemon, lambda: daemon.axes[0].good, "the drive again", 60_000 * MS)
