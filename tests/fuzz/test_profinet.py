"""Many damaged frames and datagrams: no exception, no growing queue, and the controller's relationship continues."""

from __future__ import annotations

import gc
import random
import tracemalloc

import pytest

from pdgw.base.durations import MS
from pdgw.peers.controller.controller import Phase
from pdgw.profinet.connection.cmdev import Event
from pdgw.profinet.model import API_PROFIDRIVE
from pdgw.profinet.rpc.dcerpc import ACYCLIC_PORT
from tests.fuzz.amount import INPUTS, SEED, damage
from tests.support.wire.profinet import DEVICE_MAC, PLC_IP, PLC_MAC, Wire

UNKNOWN_MAC = bytes.fromhex("020000000099")
AXIS = (1, 2)
COUNT = max(INPUTS, 6_000)
"""Of each of the two tests; `make fuzz` asks for more."""
WATCHED = 3_000
"""Inputs at the end during which the memory is watched, which takes time."""
LEAK = 100_000
"""Bytes that logs and caches of bounded size may still grow by."""


def conversation() -> tuple[list[bytes], list[bytes]]:
    """Frames and datagrams of a controller, each kind of them once."""
    wire = Wire()
    frames: dict[bytes, bytes] = {}
    datagrams: list[bytes] = []
    original = wire.plc.outgoing

    def outgoing() -> list[tuple[tuple[str, int] | None, bytes | bytearray]]:
        items = original()
        for address, data in items:
            if address is None:
                frames.setdefault(bytes(data[14:22]) + len(data).to_bytes(2, "big"), bytes(data))
            else:
                datagrams.append(bytes(data))
        return items

    wire.plc.outgoing = outgoing  # type: ignore[method-assign]
    wire.device.set_diagnosis((1, 1), 0x9000)
    wire.connect()
    for index in (0xB02E, 0xAFF0, 0x8001, 0xE040):
        wire.plc.write((API_PROFIDRIVE, 1, 1), index, bytes(200), lambda result: None)
        wire.plc.read((API_PROFIDRIVE, 1, 1), index, lambda result: None)
    wire.plc.write((API_PROFIDRIVE, 1, 1), 0xB02E, bytes(3000), lambda result: None)
    wire.run(100 * MS)
    wire.plc.release(wire.now)
    wire.run(20 * MS)
    return list(frames.values()), datagrams


@pytest.fixture(scope="module")
def seeds() -> tuple[list[bytes], list[bytes]]:
    return conversation()


def test_unknown_senders_neither_disturb_the_controller_nor_fill_memory(seeds: tuple[list[bytes], list[bytes]]) -> None:
    frames, datagrams = seeds
    chance = random.Random(SEED)
    wire = Wire(seed=2)
    wire.connect()
    relation = wire.device.relation
    wire.plc.set_output(AXIS, b"\1\2\3\4")
    device = wire.device
    before = 0
    for number in range(COUNT):
        if chance.random() < 0.5:
            frame = damage(chance.choice(frames), chance, 12)
            source = UNKNOWN_MAC if frame[6:12] == PLC_MAC else frame[6:12]
            device.on_frame(frame[:6] + source + frame[12:], wire.now)
        else:
            port = chance.randrange(49_152, 49_160)
            device.on_datagram(damage(chance.choice(datagrams), chance, 0), ("192.168.0.99", port), wire.now)
        if number % 50 == 0:
            wire.frames.clear()
            wire.times.clear()
            wire.events.clear()
            device.outgoing()
            wire.run(4 * MS)
            assert device.relation is relation
            assert device.output(AXIS) == b"\1\2\3\4"
        if number == COUNT - WATCHED:
            wire.frames.clear()
            wire.times.clear()
            gc.collect()
            tracemalloc.start()
            before = tracemalloc.get_traced_memory()[0]
    wire.frames.clear()
    wire.times.clear()
    wire.events.clear()
    gc.collect()
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert grown < LEAK
    assert len(device.cm.relations) <= 3
    assert device.connected
    assert wire.plc.phase is Phase.DATA


def test_faulty_controller_at_most_ends_its_own_relationship(seeds: tuple[list[bytes], list[bytes]]) -> None:
    frames, datagrams = seeds
    chance = random.Random(f"{SEED} mad")
    wire = Wire(seed=2)
    device = wire.device
    for number in range(COUNT):
        if chance.random() < 0.5:
            frame = damage(chance.choice(frames), chance, 14)
            device.on_frame((DEVICE_MAC + PLC_MAC + frame[12:]) if len(frame) > 12 else frame, wire.now)
        else:
            device.on_datagram(damage(chance.choice(datagrams), chance, 0), (PLC_IP, ACYCLIC_PORT), wire.now)
        if number % 20 == 0:
            wire.now += 3 * MS
            device.poll(wire.now)
            device.outgoing()
            device.events()
        assert len(device.cm.relations) <= 3
    # Whatever happened: the device is found, connects and works as ever.
    device.end(Event.STOPPED, wire.now)
    device.outgoing()
    device.station.name, device.station.ip = "gateway", Wire().station.ip
    wire.connect()
    wire.run(100 * MS)
    assert device.connected
