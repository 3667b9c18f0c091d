"""The gateway's end of a CAN bus: what a network sends through and what delivers frames to it.

``CanPort`` is the protocol; a SocketCAN-like python-can bus is used by its socket, with the 16 bytes of a frame, any other
python-can bus through its own methods on threads that only queue, so that no driver can make the loop wait.
"""

from __future__ import annotations

import contextlib
import errno
import queue
import socket
import threading
from collections import deque
from collections.abc import Callable
from typing import Final, Protocol

import can
from can.interfaces.socketcan import SocketcanBus

from pdgw.base.durations import US
from pdgw.ds301.bus.can_frame import (
    CAN_FRAME,
    ERROR,
    ERROR_BUS_OFF,
    ERROR_CONTROLLER,
    EXTENDED,
    FD_FRAME_SIZE,
    REMOTE,
)
from pdgw.ds301.bus.interfaces import system_text
from pdgw.ds301.loop.arrivals import ANCILLARY, Arrivals
from pdgw.ds301.loop.loop import Loop, Timer

_pack_frame: Final = CAN_FRAME.pack
_unpack_frame: Final = CAN_FRAME.unpack
_FRAME_SIZE: Final = CAN_FRAME.size
_AT_ONCE: Final = 64
"""Frames taken in one turn of the loop: a flood on one bus must not keep the others waiting."""
_WAITING: Final = 256
"""Frames taken in one cycle: more than a bus has in its time."""
_RECEIVE_TIMEOUT_S: Final = 0.2
_SEND_QUEUE: Final = 16
"""Frames that may wait for a slow driver. A stop waits for them."""
_ROOM: Final = _SEND_QUEUE // 2
"""So few frames left in the queue are reported as room."""
_SMALLEST_BUFFER: Final = 0
"""SO_SNDBUF: the kernel uses its minimum, which is about 6 CAN frames. A stop waits for them."""
_FULL_NS: Final = 250 * US
"""The interface's queue (txqueuelen) is full, and the kernel does not report room: time until the next try."""
_AF_CAN: Final = getattr(socket, "AF_CAN", None)
_SEND_TIMEOUT_S: Final = 0.1
"""A driver that may wait for room waits no longer for one frame."""
_SEND_AGAIN_S: Final = 0.001
"""Pause before the next try of a frame that a driver refused."""
_DROP: Final = can.Message()
"""Among the frames for the driver: empty your own buffer."""
_FLAGS: Final = EXTENDED | REMOTE | ERROR
"""None of them: a data frame with a standard identifier."""
_PASSIVE: Final = 0x30
"""Data byte 1 of a controller problem: error-passive, receiving or sending."""


class PortBusyError(Exception):
    """The interface does not take the frame just now; it works."""


class PortLostError(Exception):
    """The interface is gone or down; the text says why."""


class Receiver(Protocol):
    """Receiver of a port's events, on the loop's thread."""

    def on_frame(self, can_id: int, data: bytes, now: int) -> None:
        """A data frame with a standard identifier. ``now``: when it arrived, in monotonic nanoseconds."""

    def on_other_frame(self, can_id: int, data: bytes, *, extended: bool, remote: bool) -> None:
        """A frame with an extended identifier, or a remote frame."""

    def on_error_frame(self, *, bus_off: bool, passive: bool) -> None:
        """The controller reports an error on the bus."""

    def on_room(self) -> None:
        """The port, which raised PortBusyError before, takes frames again."""

    def on_refused(self) -> None:
        """A frame that the port had taken did not go out."""

    def on_lost(self, text: str) -> None:
        """The interface does not work any more: the port is closed, another one has to be opened."""


def deliver(receiver: Receiver, can_id: int, data: bytes, now: int) -> None:
    """A frame that arrived at ``now``, whose identifier has the flags of ``can_frame``."""
    if not can_id & _FLAGS:
        receiver.on_frame(can_id, data, now)
    elif can_id & ERROR:
        passive = bool(can_id & ERROR_CONTROLLER and len(data) > 1 and data[1] & _PASSIVE)
        receiver.on_error_frame(bus_off=bool(can_id & ERROR_BUS_OFF), passive=passive)
    else:
        extended = bool(can_id & EXTENDED)
        identifier = can_id & ~(EXTENDED | REMOTE)
        receiver.on_other_frame(identifier, data, extended=extended, remote=bool(can_id & REMOTE))


class CanPort(Protocol):
    """One end of a CAN bus."""

    def start(self, receiver: Receiver) -> None:
        """Deliver frames from now on."""

    def send(self, can_id: int, data: bytes) -> None:
        """Send a frame without waiting; PortBusyError (``on_room`` follows) or PortLostError when it is not taken.

        With ``REMOTE`` in the identifier it is a request of as many bytes as ``data`` has.
        """

    def listen(self, *, on: bool) -> None:
        """Whether a frame is delivered when it arrives (the beginning), or waits for ``take`` if the port can do this."""

    def take(self, now: int) -> None:
        """Deliver the frames that have waited until ``now``, with their times of arrival."""

    def drop(self) -> None:
        """Forget the frames that have not gone out, where the interface can: what they say is not true any more."""

    def close(self) -> None:
        """Release the interface; a second call does nothing."""


def open_port(loop: Loop, bus: can.BusABC) -> CanPort:
    """The port of a python-can bus, which becomes its own."""
    return SocketPort(loop, bus) if isinstance(bus, SocketcanBus) else DriverPort(loop, bus)


class SocketPort(CanPort):
    """SocketCAN, and what looks like it: frames as 16 bytes over the socket, read in the loop."""

    def __init__(self, loop: Loop, bus: SocketcanBus) -> None:
        self._loop = loop
        self._bus = bus
        self._socket = bus.socket
        self._send, self._receive = self._socket.send, self._socket.recv
        self._channel: object = getattr(bus, "channel", None)
        self._socket.setblocking(False)
        if self._socket.family == _AF_CAN:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SMALLEST_BUFFER)
        self._receiver: Receiver | None = None
        self._arrivals = Arrivals(loop)
        self._closed = False
        self._room_due: Timer | None = None

    def start(self, receiver: Receiver) -> None:
        self._receiver = receiver
        self._loop.add_reader(self._socket.fileno(), self._read)

    def send(self, can_id: int, data: bytes) -> None:
        try:
            self._send(_pack_frame(can_id, len(data), data))
        except BlockingIOError as error:
            self._loop.add_writer(self._socket.fileno(), self._has_room)
            raise PortBusyError from error
        except OSError as error:
            if error.errno == errno.ENOBUFS:
                if self._room_due is None:
                    self._room_due = self._loop.call_later(_FULL_NS, self._has_room)
                raise PortBusyError from error
            raise PortLostError(system_text(error, self._channel)) from error

    def _has_room(self) -> None:
        self._room_due = None
        self._loop.remove_writer(self._socket.fileno())
        if self._receiver is not None:
            self._receiver.on_room()

    def drop(self) -> None:
        """Not possible in the kernel: its queue (SO_SNDBUF, txqueuelen) is sent before new frames."""

    def _read(self) -> None:
        """One frame: the loop asks for the next one, of all buses in one call; a socket that has none takes longer to say so."""
        try:
            frame = self._receive(FD_FRAME_SIZE)
        except BlockingIOError:
            return
        except OSError as error:
            self._lost(system_text(error, self._channel))
            return
        self._deliver(frame, self._loop.now())

    def listen(self, *, on: bool) -> None:
        if on:
            self._loop.add_reader(self._socket.fileno(), self._read)
        else:
            self._loop.remove_reader(self._socket.fileno())

    def take(self, now: int) -> None:
        for _ in range(_WAITING):
            if self._closed:
                return
            try:
                frame, ancillary, _, _ = self._socket.recvmsg(FD_FRAME_SIZE, ANCILLARY)
            except BlockingIOError:
                self._arrivals.end(now)
                return
            except OSError as error:
                self._lost(system_text(error, self._channel))
                return
            self._deliver(frame, self._arrivals.time(ancillary, now) or now)

    def _deliver(self, frame: bytes, now: int) -> None:
        receiver = self._receiver
        # An interface with fd = true also delivers CAN FD frames, which CANopen does not use.
        if len(frame) == _FRAME_SIZE and receiver is not None:
            can_id: int
            length: int
            data: bytes
            can_id, length, data = _unpack_frame(frame)
            if length < 8:
                data = data[:length]
            if can_id & _FLAGS:
                deliver(receiver, can_id, data, now)
            else:
                receiver.on_frame(can_id, data, now)

    def _lost(self, text: str) -> None:
        receiver = self._receiver
        self.close()
        if receiver is not None:
            receiver.on_lost(text)

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            self._loop.remove_reader(self._socket.fileno())
            self._loop.remove_writer(self._socket.fileno())
            if self._room_due is not None:
                self._room_due.cancel()
            _shut_down(self._bus)


class DriverPort(CanPort):
    """Any python-can bus: its driver may block, so sending and receiving each have a thread that only queues."""

    def __init__(self, loop: Loop, bus: can.BusABC) -> None:
        self._loop = loop
        self._bus = bus
        self._receiver: Receiver | None = None
        self._received: deque[can.Message] = deque()
        self._sending: queue.Queue[tuple[int, can.Message] | None] = queue.Queue(_SEND_QUEUE)
        """Frames, each with the number of drops before it."""
        self._drops = 0
        self._full = False
        """A frame was refused: the writer reports when there is room."""
        self._stopping = threading.Event()
        self._closed = False
        self._threads = [
            threading.Thread(target=self._read, name="CAN reader", daemon=True),
            threading.Thread(target=self._write, name="CAN writer", daemon=True),
        ]

    def start(self, receiver: Receiver) -> None:
        self._receiver = receiver
        for thread in self._threads:
            thread.start()

    def send(self, can_id: int, data: bytes) -> None:
        if self._stopping.is_set():
            raise PortLostError("the driver has stopped")
        try:
            self._sending.put_nowait((self._drops, _message(can_id, data)))
        except queue.Full as error:
            self._full = True
            if self._sending.qsize() <= _ROOM:  # the writer was faster and does not check again
                self._loop.call_threadsafe(self._has_room)
            raise PortBusyError from error

    def listen(self, *, on: bool) -> None:
        """Not possible: its thread does not know when a frame arrived."""

    def take(self, now: int) -> None:
        """No frame waits."""

    def drop(self) -> None:
        self._drops += 1
        with contextlib.suppress(queue.Empty):
            while True:
                self._sending.get_nowait()
        self._sending.put_nowait((self._drops, _DROP))

    def close(self) -> None:
        if self._closed:
            return
        self._closed = True
        # Frames queued before are still sent, including the stop of a drive.
        with contextlib.suppress(queue.Full):
            self._sending.put_nowait(None)
        if self._threads[1].is_alive():
            self._threads[1].join(_RECEIVE_TIMEOUT_S * 5)
        self._stopping.set()
        if self._threads[0].is_alive():
            self._threads[0].join(_RECEIVE_TIMEOUT_S * 5)
        _shut_down(self._bus)

    # -- the threads ----------------------------------------------------------------------------------------------------

    def _read(self) -> None:
        while not self._stopping.is_set():
            try:
                message = self._bus.recv(_RECEIVE_TIMEOUT_S)
            except Exception as error:  # drivers raise any exception: this one has failed
                self._fail(f"{type(error).__name__}: {error}")
                return
            if message is not None:
                self._received.append(message)
                if len(self._received) == 1:
                    self._loop.call_threadsafe(self._deliver)

    def _write(self) -> None:
        while (item := self._sending.get()) is not None:
            number, message = item
            if self._full and self._sending.qsize() <= _ROOM:
                self._full = False
                self._loop.call_threadsafe(self._has_room)
            try:
                if message is _DROP:
                    self._bus.flush_tx_buffer()
                else:
                    self._transmit(number, message)
            except NotImplementedError:
                continue  # this driver's buffer cannot be cleared
            except Exception as error:  # drivers raise any exception: this one has failed
                self._fail(f"{type(error).__name__}: {error}")
                return

    def _transmit(self, number: int, message: can.Message) -> None:
        """Send a frame. Repeat it while the driver refuses it, because no frame may overtake it, and until it is dropped."""
        reported = False
        while number == self._drops:
            try:
                self._bus.send(message, _SEND_TIMEOUT_S)
            except can.CanOperationError:
                if not reported:
                    reported = True
                    self._loop.call_threadsafe(self._refused)
            else:
                return
            if self._stopping.wait(_SEND_AGAIN_S):
                return

    def _fail(self, text: str) -> None:
        if not self._stopping.is_set():
            self._stopping.set()
            self._loop.call_threadsafe(lambda: self._lost(text))

    # -- the loop's thread ----------------------------------------------------------------------------------------------

    def _lost(self, text: str) -> None:
        receiver = self._receiver
        self.drop()  # a full queue has no room for the order to end
        self.close()
        if receiver is not None:
            receiver.on_lost(text)

    def _has_room(self) -> None:
        if self._receiver is not None and not self._closed:
            self._receiver.on_room()

    def _refused(self) -> None:
        if self._receiver is not None and not self._closed:
            self._receiver.on_refused()

    def _deliver(self) -> None:
        for _ in range(_AT_ONCE):
            try:
                message = self._received[0]
            except IndexError:
                return
            self._dispatch(message)
            self._received.popleft()
        if self._received:
            self._loop.call_threadsafe(self._deliver)

    def _dispatch(self, message: can.Message) -> None:
        receiver = self._receiver
        # CANopen does not use CAN FD. Some drivers also deliver the own frames (gs_usb), which would be those of another master.
        if receiver is None or self._closed or message.is_fd or not message.is_rx:
            return
        if message.is_error_frame:
            bus_off = bool(message.arbitration_id & ERROR_BUS_OFF) or self._state() is can.BusState.ERROR
            receiver.on_error_frame(bus_off=bus_off, passive=self._state() is can.BusState.PASSIVE)
        elif message.is_extended_id or message.is_remote_frame:
            receiver.on_other_frame(
                message.arbitration_id,
                bytes(message.data),
                extended=message.is_extended_id,
                remote=message.is_remote_frame,
            )
        else:
            receiver.on_frame(message.arbitration_id, bytes(message.data), self._loop.now())

    def _state(self) -> can.BusState:
        try:
            return self._bus.state
        except Exception:  # this driver does not support it
            return can.BusState.ACTIVE


def _message(can_id: int, data: bytes) -> can.Message:
    """For a driver; the identifier has the flags of ``can_frame``."""
    if can_id & REMOTE:
        identifier, count = can_id & ~REMOTE, len(data)
        return can.Message(
            arbitration_id=identifier, is_remote_frame=True, dlc=count, is_extended_id=False, is_rx=False
        )
    return can.Message(arbitration_id=can_id, data=data, is_extended_id=False, is_rx=False)


def _shut_down(bus: can.BusABC) -> None:
    """Release a bus; a driver that fails at it has nothing left to release."""
    try:
        bus.shutdown()
    except Exception:  # drivers raise any exception
        # Mark the base class as closed, else the garbage collector closes it again and prints the exception.
        with contextlib.suppress(Exception):
            can.BusABC.shutdown(bus)


Opener = Callable[[], CanPort]
"""Open the interface, at start and again after a loss; CanopenError if it cannot be opened."""
