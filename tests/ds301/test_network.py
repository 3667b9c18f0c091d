"""The CAN network: who gets which frame, what a bad frame or a bad interface does."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator
from functools import partial
from random import Random

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.bus.interfaces import open_bus
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.bus.port import CanPort, PortBusyError, PortLostError, Receiver, open_port
from pdgw.ds301.communication import NMT, SDO_RESPONSE
from pdgw.ds301.loop.virtual_loop import VirtualLoop
from pdgw.peers.world.can_bus import SimulatedCan
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
    with buses.looped() as loop:
        network = buses.network(loop, bus)
        network.start()
        yield network
        network.close()


def frame(can_id: int, data: bytes = b"", **flags: bool) -> can.Message:
    return can.Message(arbitration_id=can_id, data=data, is_extended_id=flags.pop("is_extended_id", False), **flags)


def flush(bus: ScriptedBus, network: CanNetwork) -> None:
    """Until the reader has taken everything put in before."""
    passed: list[bytes] = []
    network.subscribe_pdo(0x1FF, lambda data, _now: passed.append(data))
    bus.incoming.put(frame(0x1FF))
    buses.wait_for(lambda: passed, "everything read")


def test_a_subscribed_pdo_goes_to_its_owner_and_nothing_else_does(bus: ScriptedBus, network: CanNetwork) -> None:
    pdos: list[bytes] = []
    others: list[int] = []
    network.subscribe_pdo(PDO, lambda data, now: pdos.append(data))
    for can_id in (PDO, 0x704):
        network.subscribe(can_id, partial(lambda can_id, _data, _now: others.append(can_id), can_id))
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


@given(can_id=st.integers(0, 0x7FF), data=st.binary(max_size=8))
def test_no_frame_ends_the_reception(can_id: int, data: bytes) -> None:
    network = CanNetwork(VirtualLoop(), PlainPort)
    network.on_frame(can_id, data, network.loop.now())
    assert network.received == 1


class PlainPort:
    """A port without a bus: ``refuse`` is raised by ``send``."""

    def __init__(self) -> None:
        self.refuse: Exception | None = None
        self.receiver: Receiver | None = None
        self.closed = False
        self.sent: list[tuple[int, bytes]] = []

    def start(self, receiver: Receiver) -> None:
        self.receiver = receiver

    def send(self, can_id: int, data: bytes) -> None:
        if self.refuse is not None:
            raise self.refuse
        self.sent.append((can_id, data))

    def drop(self) -> None:
        pass

    def close(self) -> None:
        self.closed = True


class Ports:
    """Opens ports; the interface is ``missing`` this number of times."""

    def __init__(self) -> None:
        self.opened: list[PlainPort] = []
        self.missing = 0

    def __call__(self) -> PlainPort:
        if self.missing:
            self.missing -= 1
            raise CanopenError("CAN interface", "can0", "a reachable one")
        self.opened.append(PlainPort())
        return self.opened[-1]


def test_an_interface_that_is_lost_is_opened_again_when_it_is_back(caplog: pytest.LogCaptureFixture) -> None:
    loop, ports = VirtualLoop(), Ports()
    network = CanNetwork(loop, ports)
    network.start()
    ports.opened[0].refuse = PortLostError("No such device")
    ports.missing = 5
    assert not network.send(0x201, b"\0")
    assert ports.opened[0].closed
    assert (network.healthy, network.lost) == (False, 1)
    assert "No such device" in caplog.text
    assert not network.send(0x201, b"\0"), "nothing is sent, nothing is raised while it is away"
    loop.run_for(20 * SECOND)
    assert len(ports.opened) == 2
    assert network.send(0x201, b"\0")
    assert not network.healthy, "not before a node is heard"
    network.on_frame(0x701, b"\x05", network.loop.now())
    assert network.healthy
    network.close()
    assert ports.opened[1].closed


class WaitingSender:
    """A sender with one frame for each of its turns."""

    def __init__(self, network: CanNetwork, data: bytes) -> None:
        self.network, self.data = network, data

    def send_waiting(self) -> bool:
        return self.network.put(0x301, self.data)


def test_nothing_that_waited_for_a_lost_interface_is_sent_when_it_is_back() -> None:
    loop, ports = VirtualLoop(), Ports()
    network = CanNetwork(loop, ports)
    network.start()
    for number in range(2):
        port = ports.opened[number]
        port.refuse = PortBusyError()
        data = bytes((number,))
        network.send(0x201, data)
        network.send(NMT, data)
        network.wait(WaitingSender(network, data), stop=False)
        if number == 0:
            network.on_lost("unplugged")
            loop.run_for(SECOND)
    port.refuse = None
    network.on_room()
    assert {frame for port in ports.opened for frame in port.sent} == {(0x201, b"\1"), (NMT, b"\1"), (0x301, b"\1")}


def test_interface_that_is_down_is_reported_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level("INFO", "gateway")
    loop, ports = VirtualLoop(), Ports()
    network = CanNetwork(loop, ports)
    network.start()
    network.on_lost("Network is down")
    for _ in range(10):  # SocketCAN binds to it, and reports it with the next readiness
        count = len(ports.opened)
        loop.until(lambda count=count: len(ports.opened) > count, "another try")  # type: ignore[misc]
        loop.call_later(MS, lambda: network.on_lost("Network is down"))
    begun = loop.now()
    loop.until(lambda: len(ports.opened) == 12, "another try")
    assert loop.now() - begun >= SECOND, "tries become rare"
    loop.run_for(SECOND)
    assert network.lost == 1
    assert [record.levelname for record in caplog.records] == ["ERROR", "INFO"]
    network.on_lost("Network is down")
    assert network.lost == 2
    network.close()


def test_a_closed_network_opens_nothing_again() -> None:
    loop, ports = VirtualLoop(), Ports()
    network = CanNetwork(loop, ports)
    network.start()
    network.on_lost("unplugged")
    network.close()
    loop.run_for(20 * SECOND)
    assert len(ports.opened) == 1


def test_only_a_permanently_full_queue_is_reported() -> None:
    loop, ports = VirtualLoop(), Ports()
    network = CanNetwork(loop, ports)
    network.start()
    port = ports.opened[0]
    port.refuse = PortBusyError()
    assert not network.send(0x201, b"\0")
    loop.run_for(99 * MS)
    assert not network.send(0x202, b"\0")
    assert network.healthy
    port.refuse = None
    network.on_room()
    assert port.sent == [(0x201, b"\0"), (0x202, b"\0")], "what waited is sent"
    port.refuse = PortBusyError()
    network.send(0x201, b"\0")
    loop.run_for(100 * MS)
    network.send(0x202, b"\0")
    assert not network.healthy
    assert (network.waits, network.send_errors) == (4, 0)


@pytest.mark.parametrize("error", [can.CanOperationError("down"), OSError("gone"), RuntimeError("WebsocketClosed")])
def test_bus_is_reopened_after_any_exception_of_a_driver(error: Exception) -> None:
    made: list[ScriptedBus] = []

    with buses.looped() as loop:

        def opener() -> CanPort:
            made.append(ScriptedBus())
            return open_port(loop, made[-1])

        network = CanNetwork(loop, opener)
        network.start()
        made[0].incoming.put(error)
        buses.wait_for(lambda: not network.healthy, "unhealthy")
        buses.wait_for(lambda: len(made) == 2, "opened again")
        flush(made[1], network)
        assert network.healthy
        network.close()


def test_a_frame_the_driver_did_not_send_is_counted(bus: ScriptedBus, network: CanNetwork) -> None:
    def refuse(_: can.Message) -> None:
        raise can.CanOperationError("transmit buffer full")

    bus.answer = refuse
    network.send(0x201, b"\0")
    buses.wait_for(lambda: network.send_errors == 1, "counted")
    assert network.healthy


def test_no_frame_overtakes_one_that_the_driver_refused(bus: ScriptedBus, network: CanNetwork) -> None:
    """A Controlword before its data would start a drive towards the target of an earlier task."""
    data, control = 0x301, 0x201

    def refuse(message: can.Message) -> None:
        if message.arbitration_id == data and len(bus.taken) <= 3:
            raise can.CanOperationError("transmit buffer full")

    bus.answer = refuse
    network.send(data, b"target")
    network.send(control, b"start")
    buses.wait_for(lambda: control in [message.arbitration_id for message in bus.taken], "the Controlword")
    assert [message.arbitration_id for message in bus.taken] == [data, data, data, data, control]
    buses.wait_for(lambda: network.send_errors, "counted")
    assert network.send_errors == 1, "one frame, however often it was tried"


def test_frame_that_a_driver_refuses_is_dropped_on_demand(bus: ScriptedBus, network: CanNetwork) -> None:
    refuses, passed = [True], []

    def refuse(message: can.Message) -> None:
        if refuses:
            raise can.CanOperationError("transmit buffer full")
        passed.append(bytes(message.data))

    bus.answer = refuse
    network.send(0x201, b"enable")
    buses.wait_for(lambda: network.send_errors, "refused")
    network.drop_waiting()
    network.send(0x201, b"stop")
    buses.wait_for(lambda: network.send_errors == 2, "the stop is tried")
    refuses.clear()
    buses.wait_for(lambda: passed, "the stop")
    assert passed == [b"stop"]


def test_blocking_driver_does_not_block_the_loop(bus: ScriptedBus, network: CanNetwork) -> None:
    release = threading.Event()
    bus.answer = lambda _: release.wait(buses.PATIENCE_S) and None
    for number in range(1000):
        network.send(0x201, number.to_bytes(2, "little"))
    assert network.send_errors > 0, "the queue is bounded"
    release.set()


def test_only_bus_off_makes_an_error_frame_a_failure(bus: ScriptedBus, network: CanNetwork) -> None:
    bus.incoming.put(frame(0x08, bytes(8), is_error_frame=True))
    flush(bus, network)
    assert (network.healthy, network.health.error_frames) == (True, 1)
    bus.incoming.put(frame(0x40, bytes(8), is_error_frame=True))
    buses.wait_for(lambda: not network.healthy, "bus-off")
    assert (network.health.error_frames, network.health.bus_off) == (2, 1)
    flush(bus, network)
    assert network.healthy


def test_answer_during_send_is_received(bus: ScriptedBus, network: CanNetwork) -> None:
    answers: list[bytes] = []
    network.subscribe_pdo(PDO, lambda data, _now: answers.append(data))

    def answer(message: can.Message) -> None:
        if message.arbitration_id == 0x204:
            bus.incoming.put(frame(PDO, b"\x07"))

    bus.answer = answer
    assert network.send(0x204, b"\x06")
    buses.wait_for(lambda: answers, "the answer")  # the driver is called by a thread of its own
    assert answers == [b"\x07"]
    assert [m.arbitration_id for m in bus.taken] == [0x204]


def test_a_listener_sees_both_directions(bus: ScriptedBus, network: CanNetwork) -> None:
    seen: list[tuple[int, bool]] = []
    network.listeners.append(lambda message: seen.append((message.arbitration_id, message.is_rx)))
    network.send_sync()
    network.send_heartbeat()
    bus.incoming.put(frame(PDO, b"\x01"))
    flush(bus, network)
    assert seen[:3] == [(0x80, False), (0x77F, False), (PDO, True)]
    buses.wait_for(lambda: len(bus.taken) == 2, "sent")
    assert [bytes(m.data) for m in bus.taken] == [b"", b"\x05"]


# The interfaces whose opening neither needs the kernel's multicast nor succeeds anywhere.
_INTERFACES = sorted(can.VALID_INTERFACES - {"udp_multicast", "virtual"})


@pytest.mark.parametrize("interface", _INTERFACES)
def test_every_interface_without_its_driver_or_channel_is_a_clear_error(interface: str) -> None:
    with pytest.raises(CanopenError, match=f"CAN interface: '{interface} channel no-such-channel'"):
        open_bus(interface, "no-such-channel", 500_000)


class Full(ScriptedBus):
    """A driver with its own buffer that blocks at its first frame until the test releases it."""

    def __init__(self) -> None:
        super().__init__()
        self.going_on = threading.Event()
        self.timeouts: list[float | None] = []
        self.emptied = 0

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self.timeouts.append(timeout)
        self.going_on.wait(buses.PATIENCE_S)
        super().send(msg)

    def flush_tx_buffer(self) -> None:
        self.emptied += 1


def test_frames_queued_for_a_driver_are_dropped_and_later_ones_sent() -> None:
    bus = Full()
    with buses.looped() as loop:
        network = buses.network(loop, bus)
        network.start()
        for number in range(5):
            network.send(PDO, bytes((number,)))
        buses.wait_for(lambda: bus.timeouts, "the driver blocks")
        network.drop_waiting()
        network.send(PDO, b"stop")
        bus.going_on.set()
        buses.wait_for(lambda: len(bus.taken) == 2, "the stop")
        network.close()
    assert [bytes(message.data) for message in bus.taken] == [b"\x00", b"stop"]
    assert bus.emptied == 1
    assert all(timeout is not None for timeout in bus.timeouts), "no driver may wait for ever"


def test_lost_driver_with_a_full_queue_ends_its_threads_and_sends_nothing_more() -> None:
    made: list[Full] = []

    def writers() -> list[threading.Thread]:
        return [thread for thread in threading.enumerate() if thread.name == "CAN writer"]

    before = writers()
    with buses.looped() as loop:

        def opener() -> CanPort:
            made.append(Full())
            return open_port(loop, made[-1])

        network = CanNetwork(loop, opener)
        network.start()
        while not network.waits:
            network.send(PDO, bytes((network.sent,)))
        made[0].incoming.put(OSError("unplugged"))
        buses.wait_for(lambda: len(made) == 2, "opened again")
        made[0].going_on.set()
        buses.wait_for(lambda: len(writers()) == len(before) + 1, "the writer of the lost driver has ended")
        made[1].going_on.set()
        network.close()
    assert len(made[0].taken) <= 1


@pytest.mark.parametrize("cycle", [4 * MS, 10 * MS])
def test_check_due_before_the_next_cycle_runs_in_this_one(cycle: int) -> None:
    """A wake of the loop of its own costs more than the look. The period stays that of the checks."""
    loop = VirtualLoop()
    network = CanNetwork(loop, lambda: open_port(loop, ScriptedBus()))
    looks: list[int] = []
    begin = loop.now()
    network.checks.add(looks.append)
    while loop.now() < begin + 40 * MS:
        loop.run_for(cycle)
        network.checks.run_before(loop.now() + cycle)
    assert [when - begin for when in looks] == [20 * MS - cycle, 40 * MS - cycle]
    loop.run_for(30 * MS)  # the exchange has ended
    assert [when - begin for when in looks[2:]] == [60 * MS]
    network.checks.remove(looks.append)
    network.checks.run_before(loop.now() + SECOND)
    network.checks.run_before(loop.now() + SECOND)
    assert len(looks) == 3
    network.close()


def test_monitors_of_a_bus_are_called_together_until_removed() -> None:
    """A wake of the loop for each node costs more than what it looks for."""
    loop = VirtualLoop()
    network = CanNetwork(loop, lambda: open_port(loop, ScriptedBus()))
    seen: list[tuple[str, int]] = []

    def first(now: int) -> None:
        seen.append(("first", now))

    def second(now: int) -> None:
        seen.append(("second", now))

    begin = loop.now()
    network.checks.add(first)
    loop.run_for(5 * MS)
    network.checks.add(second)
    loop.run_for(30 * MS)
    assert seen == [("first", begin + 20 * MS), ("second", begin + 20 * MS)]
    network.checks.remove(first)
    loop.run_for(10 * MS)
    assert seen[2:] == [("second", begin + 40 * MS)]
    network.checks.remove(second)
    loop.run_for(50 * MS)
    assert len(seen) == 3
    network.checks.add(first)
    network.close()
    loop.run_for(50 * MS)
    assert len(seen) == 3


# -- frames that wait for the cycle -----------------------------------------------------------------------------------


class Waiting:
    """A network on a simulated bus with one node, and the PDOs that it has received, with their times."""

    def __init__(self) -> None:
        self.loop = VirtualLoop()
        bus = SimulatedCan(self.loop, "can", 1_000_000, Random(1))
        self.network = CanNetwork(self.loop, lambda: bus.join("gateway"))
        self.network.start()
        self.node = bus.join("node")
        self.received: list[tuple[bytes, int, int]] = []
        self.network.subscribe_pdo(PDO, lambda data, now: self.received.append((data, now, self.loop.now())))

    def send(self, can_id: int = PDO, data: bytes = b"\x01") -> None:
        self.node.send(can_id, data)
        self.loop.run_for(MS)


def test_frames_that_wait_keep_the_time_at_which_they_arrived() -> None:
    waiting = Waiting()
    waiting.network.listen(waiting.loop.now(), on=False)
    begin = waiting.loop.now()
    waiting.send()
    assert not waiting.received
    waiting.network.take(waiting.loop.now())
    ((data, arrived, taken),) = waiting.received
    assert data == b"\x01"
    assert begin < arrived < taken == begin + MS


def test_frames_wait_for_no_cycle_while_an_sdo_is_open() -> None:
    waiting = Waiting()
    network, loop = waiting.network, waiting.loop
    network.listen(loop.now(), on=False)
    waiting.send()
    network.request_sdo(5, bytes(8), first=False)
    waiting.send()
    assert len(waiting.received) == 2
    network.listen(loop.now(), on=False)
    waiting.send()
    assert len(waiting.received) == 3, "the answer is awaited"
    waiting.send(SDO_RESPONSE + 5, bytes(8))
    network.listen(loop.now(), on=False)
    waiting.send()
    assert len(waiting.received) == 3
    network.request_sdo(5, bytes(8), first=True)
    loop.run_for(2 * SECOND)
    network.listen(loop.now(), on=False)
    waiting.send()
    assert len(waiting.received) == 4, "a node that is gone does not answer"


def test_monitors_judge_after_the_frames_that_wait() -> None:
    waiting = Waiting()
    seen: list[int] = []
    waiting.network.checks.add(lambda now: seen.append(len(waiting.received)))
    waiting.network.listen(waiting.loop.now(), on=False)
    waiting.send()
    waiting.loop.run_for(30 * MS)
    assert seen == [1]


def test_nodes_without_a_configuration_are_known_from_their_first_heartbeat_on() -> None:
    """Only one that appears after a loss may be the lost device with another node-ID."""
    network = CanNetwork(VirtualLoop(), Ports())
    network.subscribe(0x701, lambda _data, _now: None)
    for node, now in ((1, SECOND), (2, SECOND), (3, 3 * SECOND), (2, 5 * SECOND)):
        network.on_frame(0x700 + node, b"\x05", now)
    assert network.unconfigured() == [2, 3]
    assert network.unconfigured(2 * SECOND) == [3]
