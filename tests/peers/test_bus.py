"""The loopback bus between processes: what a member hears, and that its socket speaks SocketCAN's language."""

from __future__ import annotations

import selectors
import socket
import sys
from collections.abc import Callable, Iterator

import can
import canopen
import pytest
from can.interfaces.socketcan.socketcan import build_can_frame
from hypothesis import given
from hypothesis import strategies as st

from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.bus.can_frame import CAN_FRAME, EXTENDED, pack_frame, unpack_frame
from pdgw.ds301.bus.interfaces import open_bus
from pdgw.gateway.base.errors import GatewayError
from pdgw.peers.bus import INTERFACE, Hub, LoopbackBus, ServedBus
from pdgw.peers.bus.hub import JOIN, PROBE, WELCOME
from pdgw.peers.drive import SimulatedDrive
from tests.support.buses import PATIENCE_S


@pytest.fixture
def channel() -> Iterator[str]:
    with ServedBus() as bus:
        yield bus.channel


@given(st.integers(0, 0x7FF), st.binary(max_size=8), st.booleans())
def test_prepared_frames_are_those_of_python_can(can_id: int, data: bytes, extended: bool) -> None:
    message = can.Message(arbitration_id=can_id, data=data, is_extended_id=extended)
    identifier = can_id | (EXTENDED if extended else 0)
    theirs = build_can_frame(message)
    # Byte 7 is len8_dlc, which has a meaning for lengths above 8 only; python-can fills it in always.
    assert pack_frame(identifier, data) == theirs[:7] + b"\0" + theirs[8:]
    assert unpack_frame(theirs) == (identifier, data)


@pytest.mark.parametrize(
    "message",
    [
        can.Message(arbitration_id=0x181, data=b"\x37\x06\xff", is_extended_id=False),
        can.Message(arbitration_id=0x1ABCDEF0, data=bytes(8), is_extended_id=True),
        can.Message(arbitration_id=0x701, dlc=1, is_remote_frame=True, is_extended_id=False),
        can.Message(arbitration_id=0x80, is_extended_id=False),
    ],
    ids=["data", "extended", "remote", "empty"],
)
@pytest.mark.parametrize("platform", ["linux", "darwin"])
def test_frame_is_received_by_all_members_except_its_sender(
    channel: str, message: can.Message, platform: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "platform", platform)
    with (
        open_bus(INTERFACE, channel) as one,
        open_bus(INTERFACE, channel) as two,
        open_bus(INTERFACE, channel) as three,
    ):
        one.send(message)
        for other in (two, three):
            heard = other.recv(PATIENCE_S)
            assert heard is not None
            assert heard.equals(message, timestamp_delta=None, check_channel=False, check_direction=False)
            assert heard.timestamp > 0
        three.send(message)
        assert two.recv(PATIENCE_S) is not None
        assert one.recv(PATIENCE_S) is not None
        assert one.recv(0) is None, "its own frame came back"


def test_the_socket_of_a_member_takes_and_gives_can_frames(channel: str) -> None:
    with open_bus(INTERFACE, channel) as one, open_bus(INTERFACE, channel) as two:
        assert isinstance(one, LoopbackBus)
        assert isinstance(two, LoopbackBus)
        assert one.fileno() == one.socket.fileno() >= 0
        one.socket.send(pack_frame(0x201, b"\x0f\x00"))
        heard = two.recv(PATIENCE_S)
        assert heard is not None
        assert (heard.arbitration_id, bytes(heard.data)) == (0x201, b"\x0f\x00")
        two.send(can.Message(arbitration_id=0x181, data=b"\x37\x06", is_extended_id=False))
        assert unpack_frame(one.socket.recv(CAN_FRAME.size)) == (0x181, b"\x37\x06")


def test_filters_and_periodic_frames_work_without_the_kernel(channel: str) -> None:
    with open_bus(INTERFACE, channel) as one, open_bus(INTERFACE, channel) as two:
        two.set_filters([{"can_id": 0x80, "can_mask": 0x7FF}])
        one.send(can.Message(arbitration_id=0x181, is_extended_id=False))
        task = one.send_periodic(can.Message(arbitration_id=0x80, is_extended_id=False), 0.01)
        heard = two.recv(PATIENCE_S)
        task.stop()
        assert heard is not None
        assert heard.arbitration_id == 0x80


@pytest.mark.parametrize(
    ("channel", "told"), [("127.0.0.1:1", "pdgw sim bus --serve"), ("can0", "HOST:PORT"), ("127.0.0.1:x", "HOST:PORT")]
)
def test_missing_bus_is_reported_with_the_command_that_opens_one(channel: str, told: str) -> None:
    with pytest.raises(CanopenError, match=told):
        open_bus(INTERFACE, channel)


def test_a_port_in_use_is_reported() -> None:
    with ServedBus() as bus, pytest.raises(GatewayError, match="choose another"):
        ServedBus(int(bus.channel.rpartition(":")[2]))


class _Steps:
    """A hub that is served when the test says so."""

    def __init__(self) -> None:
        self.selector = selectors.DefaultSelector()
        self.hub = Hub(self.selector)

    def serve(self) -> None:
        while ready := self.selector.select(0):
            for key, _ in ready:
                key.data()

    def join(self, before: Callable[[], None] = lambda: None) -> socket.socket:
        """``before``: called before the member uses its welcome."""
        member = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        host, _, port = self.hub.channel.rpartition(":")
        member.connect((host, int(port)))
        member.send(JOIN)
        self.serve()
        answer = member.recv(64)
        before()
        member.connect((host, WELCOME.unpack(answer)[1]))
        member.send(PROBE)
        self.serve()
        return member


@pytest.fixture
def steps() -> Iterator[_Steps]:
    made = _Steps()
    yield made
    made.hub.close()
    made.selector.close()


def test_member_that_ended_without_leave_is_removed(steps: _Steps) -> None:
    living, dead = steps.join(), steps.join()
    assert steps.hub.members == 2
    dead.close()
    for _ in range(2):  # the first frame comes back as refused
        living.send(pack_frame(0x80, b""))
        steps.serve()
    assert steps.hub.members == 1
    living.close()


def test_frames_before_a_new_member_is_ready_do_not_remove_it(steps: _Steps) -> None:
    living = steps.join()

    def send() -> None:
        for _ in range(3):  # refused by the kernel: the new member has no socket for them yet
            living.send(pack_frame(0x80, b""))
            steps.serve()

    new = steps.join(send)
    assert steps.hub.members == 2
    new.send(pack_frame(0x81, b""))
    steps.serve()
    assert living.recv(64) == pack_frame(0x81, b"")
    living.close()
    new.close()


def test_device_error_does_not_end_the_bus_of_others(steps: _Steps, caplog: pytest.LogCaptureFixture) -> None:
    heard: list[bytes] = []

    def broken(frame: bytes) -> None:
        raise ValueError("a mistake")

    steps.hub.attach(broken)
    steps.hub.attach(heard.append)
    member = steps.join()
    frames = [pack_frame(0x80 + number, b"") for number in range(3)]
    for frame in frames:
        member.send(frame)
        steps.serve()
    assert heard == frames
    assert "ValueError: a mistake" in caplog.text
    member.close()


def test_invalid_datagram_is_not_forwarded(steps: _Steps) -> None:
    one, two = steps.join(), steps.join()
    for data in (b"", b"12345", bytes(15), bytes(17), pack_frame(0x80, b"")):
        one.send(data)
    steps.serve()
    assert two.recv(64) == pack_frame(0x80, b"")
    two.setblocking(False)
    with pytest.raises(BlockingIOError):
        two.recv(64)
    one.close()
    two.close()


def test_immediate_answer_is_received_after_the_request_by_all(steps: _Steps) -> None:
    heard: list[bytes] = []
    question, answer = pack_frame(0x201, b"\x0f"), pack_frame(0x181, b"\x37")
    send = steps.hub.attach(lambda frame: send(answer) if frame == question else None)
    steps.hub.attach(heard.append)
    ask = steps.hub.attach(lambda frame: None)
    outside = steps.join()
    ask(question)
    assert heard == [question, answer]
    assert [outside.recv(64), outside.recv(64)] == [question, answer]
    outside.close()


def serial_number_over(channel: str, node_id: int) -> int:
    """1018h/4, by canopen's own master."""
    network = canopen.Network()
    network.connect(interface=INTERFACE, channel=channel)
    try:
        client = network.add_node(node_id, canopen.ObjectDictionary()).sdo
        client.RESPONSE_TIMEOUT = PATIENCE_S
        return int.from_bytes(client.upload(0x1018, 4), "little")
    finally:
        network.disconnect()


def test_simulated_drive_is_read_over_the_loopback_bus(channel: str) -> None:
    with SimulatedDrive(open_bus(INTERFACE, channel), 5, serial_number=4711):
        assert serial_number_over(channel, 5) == 4711
