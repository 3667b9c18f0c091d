"""The recorder of a gateway: every cycle, every step and every frame, as segments of a recording in RAM.

A ring is a folder with segments. Each is a pcapng section of its own; its name has its number and that of its first cycle. The
recorder appends one piece in each cycle, or in 10 ms of short cycles in which nothing but the frames has changed, and deletes the
oldest segments. A reader needs no lock: what is written never changes, and a piece that is missing at the end comes later.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import shutil
import struct
from bisect import bisect_left
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pdgw.base.durations import MS, SECOND, US
from pdgw.ds301.bus.listeners import FrameTap
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.identity import build_text
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.base.run_directory import PREVIOUS, SUFFIX, locked
from pdgw.gateway.configuration.file import public_config
from pdgw.gateway.service.cycle_times import CycleListener
from pdgw.gateway.trace import pcapng
from pdgw.gateway.trace.json_values import to_json
from pdgw.gateway.trace.steps import StepRecord, step_record
from pdgw.profidrive.frame import CYCLIC_PORT
from pdgw.profinet.ethernet import header

if TYPE_CHECKING:
    from pdgw.gateway.service.running import RunningGateway

log = logging.getLogger("gateway")

_MEGABYTE: Final = 1 << 20
_ANCHOR_NS: Final = SECOND
"""Interval at which the wall clock is read and all values are recorded."""
_SHORT_NS: Final = 2 * MS
"""Shorter cycles are written together, because each call of the system takes as long as the rest of the recording;"""
_UNWRITTEN_NS: Final = 10 * MS
"""those of this time at most."""
_SEGMENTS: Final = 16
"""The oldest sixteenth of a ring is deleted at once."""
_FLAGS: Final = (
    os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
)
_MODE: Final = 0o440
"""No other program opens a segment for writing by mistake; the gateway has it open already."""
_FOLDER_MODE: Final = 0o750
_PACK_CAN: Final = pcapng.CAN_PACKET.pack
_CAN_TAIL: Final = pcapng.CAN_TAIL
_CAN_FRAME: Final = 16
_IDENTIFIERS: Final = 0x800
_MAC: Final = 6
"""Bytes of an address."""


class _BusTap(FrameTap):
    """Records the frames of a bus as blocks, and their times. ``middles``: by identifier and size, empty: not packed yet."""

    def __init__(self, bus: int, middles: list[bytes], blocks: list[bytes], times: list[int]) -> None:
        self._head = pcapng.CAN_HEAD.pack(pcapng.PACKET, pcapng.CAN_PACKET.size, bus)
        self._middles = middles
        self._blocks = blocks
        self._times = times
        self.wall = 0
        """Wall clock minus monotonic clock."""

    def frame(self, can_id: int, data: bytes, time_ns: int) -> None:
        try:
            middle = self._middles[can_id << 4 | len(data)]
        except IndexError:  # an extended identifier, or flags
            middle = b""
        if not middle:
            middle = pcapng.CAN_MIDDLE.pack(_CAN_FRAME, _CAN_FRAME, can_id, len(data))
            if can_id < _IDENTIFIERS:
                self._middles[can_id << 4 | len(data)] = middle
        time: Any = time_ns + self.wall  # compiled code makes one object of it
        self._times.append(time)
        self._blocks.append(_PACK_CAN(self._head, time, middle, data, _CAN_TAIL))


class FlightRecorder(CycleListener):
    """Records until ``stop``; GatewayError from the constructor when the folder cannot be made."""

    def __init__(self, daemon: RunningGateway, directory: Path, name: str) -> None:
        self._daemon = daemon
        self._link = daemon.link
        self.configuration = public_config(daemon.config)
        self._limit = daemon.config.trace.megabytes * _MEGABYTE // _SEGMENTS
        self._age_ns = daemon.config.trace.seconds * SECOND // (_SEGMENTS - 1)
        self._plc = len(daemon.networks)
        self._unwritten_ns = _UNWRITTEN_NS - daemon.cycle_ns if daemon.cycle_ns < _SHORT_NS else 0
        self._is_profinet = daemon.config.transport.type == "profinet"
        self.lost = 0
        """Cycles that could not be written."""
        self._token: object = None
        self._ends: object = ()
        """The PLC, and on PROFINET the gateway, in the headers of recorded frames."""
        self._cycle = pcapng.CyclePacker()
        self._first = True
        self._head = b""
        self._number = 0
        self._count = 0
        """Of the segments."""
        self._wall = 0
        self._whole = True
        """The next cycle has all values of its steps."""
        self._anchor_due = 0
        self._began = 0
        self._size = 0
        self._file = -1
        self._segments: list[Path] = []
        self._blocks: list[bytes] = []
        """What is not written yet."""
        self._times: list[int] = []
        """Of those since the last cycle, of the wall clock."""
        self._cycles: list[int] = []
        """The begin of the cycles that are not written yet."""
        self._steps: list[StepRecord] = []
        self._shortest = 0
        """Bytes of the steps of a cycle in which only the frames have changed something."""
        try:
            self.path, self._lock = _prepared(directory, name)
        except OSError as error:
            raise GatewayError(f"flight recorder: {directory}: {error.strerror or error}") from error
        self._name = self.path.name.removesuffix(SUFFIX)
        for item in daemon.objects:
            item.given = []
        middles = [b""] * (_IDENTIFIERS << 4)
        self._taps = [_BusTap(bus, middles, self._blocks, self._times) for bus in range(self._plc)]
        for network, tap in zip(daemon.networks.values(), self._taps, strict=True):
            network.tap = tap
        daemon.loop.counters.add("trace", "lost", "cycles", "not written to the flight recorder", lambda: self.lost)
        daemon.watch.listeners.append(self)
        daemon.recorder = daemon.link.recorder = self
        self._anchor(daemon.loop.now())
        self._observe()

    def start(self) -> None:
        """Nothing to do: it records from its construction on."""

    def stop(self) -> None:
        """End in order; the folder stays."""
        if self._lock < 0:
            return
        for network in self._daemon.networks.values():
            network.tap = None
        self._link.recorder = None
        self._daemon.watch.listeners.remove(self)
        self._close()
        with contextlib.suppress(OSError):
            (self.path / "ended").touch()
        os.close(self._lock)
        self._lock = -1

    # -- the exchange -----------------------------------------------------------------------------------------------------

    def cycle(self, now: int, accepted: bool, answered: int) -> None:
        """CycleListener."""
        link = self._link
        if link.layout_token is not self._token:
            self._observe()
        connected, peer, received, sent = link.newest()
        ends: object = bytes(sent[: 2 * _MAC]) if self._is_profinet else peer
        if ends != self._ends:
            self._ends = ends
            self._find_headers(peer, sent)
        flags = pcapng.CONNECTED if connected else 0
        if self._whole:
            flags |= pcapng.WHOLE
            self._whole = False
            for step in self._steps:
                step.forget()
        response = 0
        blocks, times, wall = self._blocks, self._times, self._wall
        first = len(blocks) - len(times)
        if answered and received:
            flags |= pcapng.ANSWERED
            response = (answered - now) // US
            answered += wall
            blocks.insert(first + bisect_left(times, answered), self._to_plc.pack(answered, sent))
        if accepted:
            flags |= pcapng.FRESH
            blocks.insert(first + bisect_left(times, now + wall), self._from_plc.pack(now + wall, received))
        times.clear()
        self._number += 1
        try:
            steps = b"".join([step.take(now) for step in self._steps])
        except (struct.error, TypeError):  # a value that fits no field: the exchange continues
            self.lost += 1
            self._whole = True
        else:
            blocks.append(self._cycle.pack(self._number, now, wall, flags, response, steps))
            self._cycles.append(now)
            if accepted and len(steps) == self._shortest and now - self._cycles[0] < self._unwritten_ns:
                return
        self._flush()
        if now >= self._anchor_due:
            self._anchor(now)
        if self._size >= self._limit or now - self._began >= self._age_ns:
            self._begin(now)

    def _anchor(self, now: int) -> None:
        self._anchor_due = now + _ANCHOR_NS
        self._whole = True
        loop = self._daemon.loop
        self._wall = int(loop.wall() * SECOND) - loop.now()
        for tap in self._taps:
            tap.wall = self._wall

    # -- segments -----------------------------------------------------------------------------------------------------------

    def _observe(self) -> None:
        """The machines, and the layout of the frames, are new."""
        daemon = self._daemon
        self._token = self._link.layout_token
        known = {step.machine for step in self._steps}
        self._steps = [step_record(item) for item in daemon.objects]
        self._shortest = pcapng.MASK.size * len(self._steps)
        for step in self._steps:
            if step.machine not in known:
                step.begin()
        self._head = self._make_head()
        self._begin(daemon.loop.now())

    def _begin(self, now: int) -> None:
        """Another segment. It has every value once, so it can be read alone."""
        self._close()
        self._count += 1
        path = self.path / f"{self._count:08d}-{self._number + 1:012d}.pcapng"
        try:
            self._file = os.open(path, _FLAGS, _MODE)
        except OSError as error:
            log.warning("flight recorder: %s: %s", path, error.strerror or error)
        self._whole = True
        self._began, self._size = now, 0
        if self._file >= 0:
            self._segments.append(path)
            self._write(self._head, 0)
        if self._first:
            self._first = False
            self._head = self._make_head()
        while len(self._segments) > _SEGMENTS:
            with contextlib.suppress(OSError):
                self._segments.pop(0).unlink()

    def _make_head(self) -> bytes:
        """What each segment begins with. It takes longer than a cycle, so it is made when the layout is new."""
        daemon = self._daemon
        description = pcapng.Description(
            build=build_text(),
            name=self._name,
            process=os.getpid(),
            cycle_ns=daemon.cycle_ns,
            first=self._first,
            places=self._link.places(),
            objects=tuple(step.traced for step in self._steps),
            buses=tuple(daemon.networks),
            reasons=tuple(reason.name for reason in Reason),
        )
        text = json.dumps(to_json(description)).encode()
        return pcapng.section(self.configuration, description.buses) + pcapng.custom(pcapng.DESCRIPTION, text)

    def _flush(self) -> None:
        """Write what is not written yet."""
        self._write(b"".join(self._blocks), len(self._cycles))
        self._blocks.clear()
        self._times.clear()
        self._cycles.clear()

    def _write(self, piece: bytes, cycles: int) -> None:
        """Append a piece with a number of cycles, whole or not at all: the memory may be full."""
        if self._file < 0:
            self.lost += cycles
            return
        try:
            written = os.write(self._file, piece)
        except OSError:
            written = -1
        if written == len(piece):
            self._size += written
            return
        self.lost += cycles
        with contextlib.suppress(OSError):
            os.ftruncate(self._file, self._size)
        self._whole = True

    def _close(self) -> None:
        if self._file >= 0:
            self._flush()
            os.close(self._file)
            self._file = -1

    def ethernet(self, frame: bytes) -> None:
        """A frame from or to the PLC beside the cyclic ones, now."""
        time_ns = self._daemon.loop.now() + self._wall
        self._times.append(time_ns)
        self._blocks.append(pcapng.packet(self._plc + 1, time_ns, frame))

    def datagram(self, source: tuple[str, int], target: tuple[str, int], data: bytes) -> None:
        """A datagram of the parameter channel, now."""
        ends = (f"{host}:{port}" for host, port in (source, target))
        self.ethernet(pcapng.udp_header(*ends, len(data)) + data)

    # -- frames of the PLC ---------------------------------------------------------------------------------------------------

    def _find_headers(self, peer: tuple[str, int] | None, sent: bytes | bytearray) -> None:
        """The frames of the PLC have other ends: on PROFINET those of the newest one, which was ``sent`` with its header."""
        received_header: Callable[[int], bytes]
        sent_header: Callable[[int], bytes]
        if self._is_profinet:
            head = header(bytes(sent[_MAC : 2 * _MAC]), bytes(sent[:_MAC]))
            received_header, sent_header = lambda _: head, lambda _: b""
        else:
            here = f"{self._daemon.address[0]}:{CYCLIC_PORT}"
            there = "" if peer is None else "{}:{}".format(*peer)
            received_header = partial(pcapng.udp_header, there, here)
            sent_header = partial(pcapng.udp_header, here, there)
        self._from_plc = pcapng.FramePacker(self._plc, received_header)
        self._to_plc = pcapng.FramePacker(self._plc, sent_header)


def _prepared(directory: Path, name: str) -> tuple[Path, int]:
    """The folder that no other living gateway has, empty, and its lock. The last one of this name is kept as the previous."""
    path, lock = locked(directory, name)
    previous = path.with_name(path.name.removesuffix(SUFFIX) + PREVIOUS)
    if path.exists():
        if previous.is_dir():
            shutil.rmtree(previous)
        else:
            previous.unlink(missing_ok=True)  # of a version that kept its ring in one file
        path.replace(previous)
    path.mkdir(mode=_FOLDER_MODE)
    return path, lock
