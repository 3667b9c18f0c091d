"""The CAN network: who gets which frame, what a bad frame or a bad interface does."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pdgw.ds301.bus import open_bus
from pdgw.ds301.errors import CanopenError
from pdgw.ds301.network import CanNetwork

from tests.support import buses

PDO = 0x184


class ScriptedBus(can.BusABC):
    """Takes what is sent and delivers what the test puts in, exceptions included."""

    def __init__(self) -> None:
        self.incoming: queue.SimpleQueue[can.Message | Exception] = queue.SimpleQueue()
        self.taken: list[can.Message] = []
        self.answer: Callable[[can.Message], None] | None = None
        super().__init__("scripted")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self.taken.append(msg)
        if self.answer is not None:
            self.answer(msg)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        try:
            item = self.incoming.get(timeout=timeout)
        except queue.Empty:
            return None, False
        if isinstance(item, Exception):
            raise item
        return item, False


@pytest.fixture
def bus() -> ScriptedBus:
    return ScriptedBus()


@pytest.fixture
def network(bus: ScriptedBus) -> Iterator[CanNetwork]:
    network = CanNetwork(bus)
    network.start()
    yield network
    network.close()


def frame(can_id: int, data: bytes = b"", **flags: bool) -> can.Message:
    return can.Message(arbitration_id=can_id, data=data, is_extended_id=flags.pop("is_extended_id", False), **flags)


def flush(bus: ScriptedBus, network: CanNetwork) -> None:
    """Until the reader has taken everything put in before."""
    passed = threading.Event()
    network.subscribe_pdo(0x1FF, lambda _data, _now: passed.set())
    bus.incoming.put(frame(0x1FF))
    assert passed.wait(10)


def test_a_subscribed_pdo_goes_to_its_owner_and_nothing_else_does(bus: ScriptedBus, network: CanNetwork) -> None:
    pdos: list[bytes] = []
    others: list[int] = []
    network.subscribe_pdo(PDO, lambda data, now: pdos.append(data))
    for can_id in (PDO, 0x704):
        network.canopen.subscribe(can_id, lambda can_id, _data, _time: others.append(can_id))
    bus.incoming.put(frame(PDO, b"\x01\x02"))
    bus.incoming.put(frame(0x704, b"\x05"))
    flush(bus, network)
    assert (pdos, others) == ([b"\x01\x02"], [0x704])
    network.unsubscribe_pdo(PDO)
    network.unsubscribe_pdo(PDO)
    bus.incoming.put(frame(PDO, b"\x03"))
    flush(bus, network)
    assert (pdos, others) == ([b"\x01\x02"], [0x704, PDO])


def test_extended_and_remote_frames_are_not_mistaken_for_pdos(bus: ScriptedBus, network: CanNetwork) -> None:
    pdos: list[bytes] = []
    network.subscribe_pdo(PDO, lambda data, now: pdos.append(data))
    bus.incoming.put(frame(PDO, b"\x01", is_extended_id=True))
    bus.incoming.put(frame(PDO, is_remote_frame=True))
    flush(bus, network)
    assert pdos == []


@pytest.mark.parametrize(("can_id", "data"), [(0x84, b"\x01"), (0x704, b""), (0x84, b"")])
def test_a_malformed_frame_is_counted_and_the_reader_lives(
    bus: ScriptedBus, network: CanNetwork, can_id: int, data: bytes
) -> None:
    network.canopen.add_node(4)
    bus.incoming.put(frame(can_id, data))
    flush(bus, network)
    assert network.malformed == 1


@given(can_id=st.integers(0, 0x7FF), data=st.binary(max_size=8))
def test_no_frame_ends_the_dispatch(can_id: int, data: bytes) -> None:
    network = CanNetwork(ScriptedBus())
    network.canopen.add_node(4)
    network._dispatch(frame(can_id, data))
    network.bus.shutdown()


def test_an_interface_that_fails_is_told_and_read_again(bus: ScriptedBus, network: CanNetwork) -> None:
    bus.incoming.put(can.CanOperationError("network is down"))
    buses.wait_for(lambda: not network.healthy, "unhealthy")
    flush(bus, network)
    assert network.healthy


def test_only_bus_off_makes_an_error_frame_a_failure(bus: ScriptedBus, network: CanNetwork) -> None:
    network._dispatch(frame(0x08, bytes(8), is_error_frame=True))
    assert (network.healthy, network.error_frames) == (True, 1)
    network._dispatch(frame(0x40, bytes(8), is_error_frame=True))
    assert (network.healthy, network.error_frames) == (False, 2)
    flush(bus, network)
    assert network.healthy


def test_a_bus_that_answers_inside_send_does_not_deadlock(bus: ScriptedBus, network: CanNetwork) -> None:
    answers: list[bytes] = []
    network.subscribe_pdo(PDO, lambda data, _now: answers.append(data))

    def answer(message: can.Message) -> None:
        if message.arbitration_id == 0x204:
            bus.incoming.put(frame(PDO, b"\x07"))
            network.send(0x304, b"")

    bus.answer = answer
    assert network.send(0x204, b"\x06")
    flush(bus, network)
    assert answers == [b"\x07"]
    assert [m.arbitration_id for m in bus.taken] == [0x204, 0x304]


def test_a_listener_sees_both_directions(bus: ScriptedBus, network: CanNetwork) -> None:
    seen: list[tuple[int, bool]] = []
    network.listeners.append(lambda message: seen.append((message.arbitration_id, message.is_rx)))
    network.send_sync()
    network.send_heartbeat(127)
    bus.incoming.put(frame(PDO, b"\x01"))
    flush(bus, network)
    assert seen[:3] == [(0x80, False), (0x77F, False), (PDO, True)]
    assert [bytes(m.data) for m in bus.taken] == [b"", b"\x05"]


def test_canopens_own_frames_take_the_same_way_out(bus: ScriptedBus, network: CanNetwork) -> None:
    network.canopen.nmt.send_command(1)
    assert [(m.arbitration_id, bytes(m.data)) for m in bus.taken] == [(0, b"\x01\x00")]
    assert network.sent == 1


# The interfaces whose opening neither needs the kernel's multicast nor succeeds anywhere.
_INTERFACES = sorted(can.VALID_INTERFACES - {"udp_multicast", "virtual"})


@pytest.mark.parametrize("interface", _INTERFACES)
def test_every_interface_without_its_driver_or_channel_is_a_clear_error(interface: str) -> None:
    with pytest.raises(CanopenError, match=f"CAN interface: '{interface} channel no-such-channel'"):
        open_bus(interface, "no-such-channel", 500_000)
