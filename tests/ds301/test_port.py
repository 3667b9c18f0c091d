"""CAN interfaces that fail: what is said, and that their end makes no noise."""

from __future__ import annotations

import errno
import gc
import os
import socket
import struct
import sys
from typing import Any, cast

import can
import pytest
from can.interfaces.socketcan import SocketcanBus

from pdgw.base.durations import MS
from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.bus.can_frame import pack_frame
from pdgw.ds301.bus.interfaces import open_bus, system_text
from pdgw.ds301.bus.port import SocketPort, open_port
from pdgw.ds301.loop.arrivals import SO_TIMESTAMPNS
from pdgw.ds301.loop.system_loop import SystemLoop
from tests.support import buses


class Gone(can.BusABC):
    """A bus whose server has gone: nothing comes, and closing it fails."""

    def __init__(self) -> None:
        super().__init__("gone")

    def _recv_internal(self, _timeout: float | None) -> tuple[None, bool]:
        raise can.CanOperationError("closed unexpectedly")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise can.CanOperationError("closed unexpectedly")

    def shutdown(self) -> None:
        raise OSError(errno.ENOTCONN, "Transport endpoint is not connected")


def test_bus_of_an_ended_server_is_closed_once_without_a_message(monkeypatch: pytest.MonkeyPatch) -> None:
    unraisable: list[Any] = []
    monkeypatch.setattr(sys, "unraisablehook", unraisable.append)
    loop = SystemLoop()
    port = open_port(loop, Gone())
    port.close()
    port.close()
    del port
    loop.close()
    gc.collect()
    assert unraisable == []


@pytest.mark.parametrize(
    ("number", "text"),
    [
        (
            errno.ENETDOWN,
            "Network is down; bring it up: sudo ip link set can1 up type can bitrate 500000 restart-ms 100",
        ),
        (
            errno.EAFNOSUPPORT,
            "Address family not supported by protocol; load the kernel's CAN modules: sudo modprobe can-raw",
        ),
        (errno.ENODEV, "No such device; list the existing ones: ip link show type can"),
        (errno.EPERM, "Operation not permitted"),
    ],
)
def test_interface_that_is_down_is_reported_with_the_remedy(number: int, text: str) -> None:
    assert system_text(OSError(number, os.strerror(number)), "can1", 500_000) == text


def test_missing_interface_is_reported_with_the_command_that_lists_them(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(**_: object) -> can.BusABC:
        raise OSError(errno.ENODEV, "No such device")

    monkeypatch.setattr(can, "Bus", missing)
    with pytest.raises(CanopenError, match="No such device; list the existing ones: ip link show type can"):
        open_bus("socketcan", "can7")


class Heard:
    """The data frames a port delivered."""

    def __init__(self) -> None:
        self.frames: list[tuple[int, bytes]] = []
        self.times: list[int] = []

    def on_frame(self, can_id: int, data: bytes, now: int) -> None:
        self.frames.append((can_id, data))
        self.times.append(now)

    def on_other_frame(self, can_id: int, data: bytes, *, extended: bool, remote: bool) -> None:
        raise AssertionError

    def on_error_frame(self, *, bus_off: bool, passive: bool) -> None:
        raise AssertionError

    def on_room(self) -> None:
        raise AssertionError

    def on_refused(self) -> None:
        raise AssertionError

    def on_lost(self, text: str) -> None:
        raise AssertionError(text)


class Pair:
    """The end of a socket in place of SocketCAN's."""

    def __init__(self, end: socket.socket) -> None:
        self.socket = end

    def shutdown(self) -> None:
        self.socket.close()


def test_a_can_fd_frame_does_not_count_as_a_classic_one_with_its_identifier() -> None:
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    heard = Heard()
    with buses.looped() as loop, far:
        port = SocketPort(loop, cast(SocketcanBus, Pair(near)))
        port.start(heard)
        far.send(struct.pack("=IBBxx64s", 0x181, 64, 0, b"\xff" * 64))
        far.send(pack_frame(0x181, b"\x27\x02"))
        buses.wait_for(lambda: heard.frames, "the classic frame")
        port.close()
    assert heard.frames == [(0x181, b"\x27\x02")]


class FdBus(Gone):
    """A driver that delivers a frame of CAN FD, then a classic one."""

    def __init__(self) -> None:
        super().__init__()
        self._frames = [
            can.Message(arbitration_id=0x181, is_extended_id=False, is_fd=is_fd, data=data)
            for is_fd, data in ((True, bytes(64)), (False, b"\x27\x02"))
        ]

    def recv(self, timeout: float | None = None) -> can.Message | None:
        return self._frames.pop(0) if self._frames else None


def test_a_frame_of_can_fd_of_any_driver_is_dropped() -> None:
    heard = Heard()
    with buses.looped() as loop:
        port = open_port(loop, FdBus())
        port.start(heard)
        buses.wait_for(lambda: heard.frames, "the classic frame")
        port.close()
    assert heard.frames == [(0x181, b"\x27\x02")]


class EchoBus(Gone):
    """A driver that also delivers the frames it has sent, as gs_usb of python-can does."""

    def __init__(self) -> None:
        super().__init__()
        self._frames = [
            can.Message(arbitration_id=can_id, is_extended_id=False, is_rx=is_rx, data=b"\x05")
            for can_id, is_rx in ((0x77F, False), (0x701, True))
        ]

    def recv(self, timeout: float | None = None) -> can.Message | None:
        return self._frames.pop(0) if self._frames else None


def test_own_frame_that_a_driver_delivers_is_dropped() -> None:
    """The heartbeat of the gateway would be that of another master."""
    heard = Heard()
    with buses.looped() as loop:
        port = open_port(loop, EchoBus())
        port.start(heard)
        buses.wait_for(lambda: (0x701, b"\x05") in heard.frames, "the frame of a node")
        port.close()
    assert heard.frames == [(0x701, b"\x05")]


def test_frames_that_wait_on_a_bus_are_delivered_in_order_and_keep_no_other_descriptor_waiting() -> None:
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    heard = Heard()
    other, wake = socket.socketpair()
    seen: list[int] = []
    with buses.looped() as loop, far, other, wake:
        port = SocketPort(loop, cast(SocketcanBus, Pair(near)))
        port.start(heard)
        loop.add_reader(other.fileno(), lambda: (other.recv(1), seen.append(len(heard.frames))))
        frames = [(0x181, bytes((number,))) for number in range(10)]
        for can_id, data in frames:
            far.send(pack_frame(can_id, data))
        wake.send(b"x")
        buses.wait_for(lambda: len(heard.frames) == len(frames), "all frames")
        port.close()
        loop.remove_reader(other.fileno())
    assert heard.frames == frames
    assert seen[0] < len(frames)


@pytest.mark.skipif(sys.platform != "linux", reason="the kernel notes no times of arrival")
def test_frames_that_wait_are_taken_with_the_times_at_which_they_arrived() -> None:
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    near.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
    heard = Heard()
    with buses.looped() as loop, far:
        port = SocketPort(loop, cast(SocketcanBus, Pair(near)))
        port.start(heard)
        port.listen(on=False)
        before = loop.now()
        far.send(pack_frame(0x181, b"\x01"))
        far.send(pack_frame(0x182, b"\x02"))
        after = loop.now()
        while loop.now() <= after + MS:
            pass
        assert not heard.frames
        port.take(loop.now())
        assert heard.frames == [(0x181, b"\x01"), (0x182, b"\x02")]
        assert before <= heard.times[0] <= heard.times[1] <= after + MS // 2
        far.send(pack_frame(0x183, b"\x03"))
        port.listen(on=True)
        buses.wait_for(lambda: len(heard.frames) == 3, "a frame that waited until then")
        port.close()
