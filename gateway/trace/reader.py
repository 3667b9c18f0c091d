"""Reader of a ring or of a recording, for tools in other processes. It never delays the gateway."""

from __future__ import annotations

import json
import os
import struct
from collections import deque
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from pdgw.gateway.base.errors import GatewayError, problem, reading
from pdgw.gateway.trace import pcapng
from pdgw.gateway.trace.json_values import from_json
from pdgw.gateway.trace.pcapng import Description
from pdgw.gateway.trace.step_reader import Routes, Step, StepReader

_KEPT: Final = 4096
"""The newest cycles, which need not be read again."""
_UDP_HEADER: Final = 42
_ETHERNET_HEADER: Final = 14
_SMALLEST: Final = 12
_LARGEST: Final = 1 << 24
_CAN_HEAD: Final = struct.Struct(">IB")
_CAN_DATA: Final = 8
"""Bytes of a recorded CAN frame before its data."""


class Frame(NamedTuple):
    """A frame on interface ``interface`` (its place in ``Description.buses``, after them the PLC)."""

    wall_ns: int
    interface: int
    data: bytes


class Cycle(NamedTuple):
    """One cycle. ``time_ns`` is monotonic. ``received`` and ``sent``: the newest frames from and to the PLC, without headers."""

    number: int
    time_ns: int
    wall_ns: int
    flags: int
    """``pcapng.FRESH`` ..."""
    received: bytes
    sent: bytes
    steps: tuple[Step, ...]


class Parser:
    """The blocks of one section after the other. ``feed`` it bytes as they come; GatewayError with the offset of damage."""

    def __init__(self, name: str) -> None:
        self.description: Description | None = None
        self.configuration = ""
        self._name = name
        self._rest = b""
        self._offset = 0
        """Of the rest in the file."""
        self._received = self._sent = b""
        self._cyclic: list[bytes] = []
        """Frames from and to the PLC since the last cycle."""
        self._can: list[Frame] = []
        """CAN frames since the last cycle."""
        self._routes: Routes = {}
        self._objects: list[StepReader] = []

    def feed(self, data: bytes) -> Iterator[Description | Frame | Cycle]:
        """What is complete."""
        data = self._rest + data if self._rest else data
        at, size = 0, len(data)
        while at + _SMALLEST <= size:
            kind, length = pcapng.HEAD.unpack_from(data, at)
            if length < _SMALLEST or length % 4 or length > _LARGEST or (not at and not self._is_known(kind)):
                raise GatewayError(f"{self._place(at)}: damaged, or not a recording of the gateway")
            if at + length > size:
                break
            with reading(self._place(at)):
                item = self._block(kind, data[at : at + length])
            if item is not None:
                yield item
            at += length
        self._rest = data[at:]
        self._offset += at

    def end(self) -> None:
        """GatewayError if the file ends within a block."""
        if self._rest:
            raise GatewayError(f"{self._place(0)}: the file ends within a block")

    def _place(self, at: int) -> str:
        return f"{self._name}: offset {self._offset + at}"

    def _block(self, kind: int, block: bytes) -> Description | Frame | Cycle | None:
        if kind == pcapng.PACKET:
            _, _, interface, time_ns, captured, _ = pcapng.PACKET_HEAD.unpack_from(block)
            begin = pcapng.PACKET_HEAD.size
            frame = Frame(time_ns, interface, block[begin : begin + captured])
            if self.description is not None and interface <= len(self.description.buses):
                if interface == len(self.description.buses):
                    self._cyclic.append(frame.data)
                else:
                    self._can.append(frame)
            return frame
        if kind == pcapng.SECTION:
            self.configuration = pcapng.configuration(block)
        return self._custom(block) if kind == pcapng.CUSTOM else None

    def _is_known(self, kind: int) -> bool:
        return self.description is not None or kind in {pcapng.SECTION, pcapng.INTERFACE, pcapng.CUSTOM}

    def _take_cyclic(self, flags: int, *, is_udp: bool) -> None:
        header = _UDP_HEADER if is_udp else _ETHERNET_HEADER
        frames = iter(self._cyclic)
        if flags & pcapng.FRESH:
            self._received = next(frames, b"")[header:]
        if flags & pcapng.ANSWERED:
            self._sent = next(frames, b"")[header if is_udp else 0 :]
        self._cyclic = []

    def _custom(self, block: bytes) -> Description | Cycle | None:
        _, _, enterprise, kind, size = pcapng.CUSTOM_HEAD.unpack_from(block)
        begin = pcapng.CUSTOM_HEAD.size
        if enterprise != pcapng.ENTERPRISE:
            return None
        content = block[begin : begin + size]
        if kind == pcapng.DESCRIPTION:
            return self._describe(content)
        return self._cycle(content) if kind == pcapng.CYCLE else None

    def _describe(self, content: bytes) -> Description:
        document = json.loads(content)
        if text := problem(document["version"], pcapng.VERSION):
            raise GatewayError(f"{self._name}: {text}")
        found = from_json(document)
        if not isinstance(found, Description):
            raise TypeError("not a description")
        self.description = found
        self._routes = {}
        self._objects = [StepReader(found, place, self._routes) for place in range(len(found.objects))]
        return found

    def _take_can(self, wall: int) -> None:
        """The frames of the devices."""
        for frame in self._can:
            identifier, size = _CAN_HEAD.unpack_from(frame.data)
            key = frame.interface, identifier
            for reader, pdo in self._routes.get(key, {}).items():
                reader.take(key, pdo, frame.wall_ns - wall, frame.data[_CAN_DATA : _CAN_DATA + size])
        self._can.clear()

    def _cycle(self, content: bytes) -> Cycle | None:
        number, time_ns, wall, flags, _ = pcapng.CYCLE_HEAD.unpack_from(content)
        if self.description is None:
            raise ValueError("a cycle before the description")
        self._take_cyclic(flags, is_udp=self.description.places.kind == "udp")
        self._take_can(wall)
        at = pcapng.CYCLE_HEAD.size
        for item in self._objects:
            at = item.read(content, at, flags, self._received)
        known = [item.step for item in self._objects if item.step is not None]
        if len(known) < len(self._objects):
            return None
        return Cycle(
            number,
            time_ns,
            time_ns + wall,
            flags,
            self._received,
            self._sent,
            tuple(known),
        )


class RingReader:
    """A ring (a folder) or a recording (a file); GatewayError when it is none or damaged."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._inode = path.stat().st_ino
        except OSError as error:
            raise GatewayError(f"{path}: {error.strerror or error}") from error
        self._newest: deque[Cycle] = deque(maxlen=_KEPT)
        self._parser = Parser(str(path))
        self._file: Path | None = None
        self._offset = 0
        self._follow()
        if self._parser.description is None:
            raise GatewayError(f"{path}: not a recording of the gateway")

    @property
    def layout(self) -> Description:
        """What the newest segment contains."""
        assert self._parser.description is not None
        return self._parser.description

    @property
    def configuration(self) -> str:
        """The gateway's configuration as TOML, without secrets."""
        return self._parser.configuration

    @property
    def ended(self) -> bool:
        """The daemon ended in order. One that was killed leaves this False and writes nothing more."""
        return (self.path / "ended").exists()

    @property
    def is_alive(self) -> bool:
        """The daemon still runs."""
        if self.ended:
            return False
        try:
            os.kill(self.layout.process, 0)
        except ProcessLookupError:
            return False
        except PermissionError:
            return True  # it belongs to another process
        return True

    @property
    def replaced(self) -> bool:
        """Another ring, or none, has this name now: open it again."""
        try:
            return self.path.stat().st_ino != self._inode
        except OSError:
            return True

    def segments(self) -> list[Path]:
        """The files, the oldest first."""
        return sorted(self.path.glob("*.pcapng")) if self.path.is_dir() else [self.path]

    @property
    def newest_cycle(self) -> int:
        """Number of the newest cycle, 0 before the first one."""
        self._follow()
        return self._newest[-1].number if self._newest else 0

    def reason(self, cycle: Cycle, place: int) -> str:
        """The name of the reason of a drive object, empty for none."""
        return self.layout.reason(self.value(cycle, place, "decided", "reason") or 0)

    def value(self, cycle: Cycle, place: int, group: str, name: str) -> int | None:
        """A value of drive object ``place`` (from 0) in a cycle; None: it is not recorded."""
        at = self.layout.objects[place].place(group, name)
        values: tuple[int, ...] = getattr(cycle.steps[place], group)
        return None if at is None or at >= len(values) else values[at]

    def cycles(self, after: int = 0, at_most: int | None = None, upto: int | None = None) -> list[Cycle]:
        """The cycles after number ``after``, oldest first; ``at_most``: only the newest; ``upto``: the last one."""
        newest = self.newest_cycle
        first = after + 1 if at_most is None else max(after + 1, newest - at_most + 1)
        last = newest if upto is None else min(newest, upto)
        kept = self._newest
        if kept and first >= kept[0].number:
            return [cycle for cycle in kept if first <= cycle.number <= last]
        return [cycle for cycle in self._from(first) if first <= cycle.number <= last]

    def _from(self, first: int) -> Iterator[Cycle]:
        files = self.segments()
        begins = [_first_cycle(file) for file in files]
        start = max((place for place, begin in enumerate(begins) if begin <= first), default=0)
        for file in files[start:]:
            parser = Parser(str(file))
            for item in parser.feed(_bytes_of(file, 0)):
                if isinstance(item, Cycle):
                    yield item

    def _follow(self) -> None:
        """Read what is new."""
        while True:
            if self._file is not None:
                data = _bytes_of(self._file, self._offset)
                self._offset += len(data)
                self._newest += (item for item in self._parser.feed(data) if isinstance(item, Cycle))
            later = [file for file in self.segments() if self._file is None or file.name > self._file.name]
            if not later:
                return
            self._file, self._offset, self._parser = later[0] if self._file else later[-1], 0, Parser(str(self.path))

    # -- the telegrams --------------------------------------------------------------------------------------------------

    def setpoints(self, cycle: Cycle, place: int) -> Sequence[int] | None:
        """Raw setpoints of drive object ``place`` (from 0) in telegram order, None while they are not valid."""
        return cycle.steps[place].setpoints

    def actuals(self, cycle: Cycle, place: int) -> Sequence[int] | None:
        """Raw actual values likewise, None before the PLC was sent any."""
        offset = self.layout.places.actuals[place]
        if offset is None or not cycle.sent:
            return None
        values: Sequence[int] = self.layout.objects[place].chosen.actuals.struct.unpack_from(cycle.sent, offset)
        return values


def _first_cycle(file: Path) -> int:
    _, _, number = file.stem.rpartition("-")
    return int(number) if number.isdigit() else 0


def _bytes_of(file: Path, offset: int) -> bytes:
    try:
        with file.open("rb") as opened:
            opened.seek(offset)
            return opened.read()
    except FileNotFoundError:
        return b""  # the gateway has deleted it meanwhile
    except OSError as error:
        raise GatewayError(f"{file}: {error.strerror or error}") from error
