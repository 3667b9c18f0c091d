"""What is in a ring as a pcapng file: both buses on one clock, with the configuration, as `pdgw run --record` writes it."""

from __future__ import annotations

import heapq
import os
import tempfile
from collections.abc import Iterator, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Final

from pdgw.decoder.capture.pcapng_file import PcapngWriter, can_packet, udp_packet
from pdgw.decoder.frames.records import LinkType
from pdgw.durations import SECOND, US
from pdgw.gateway.errors import GatewayError, writing
from pdgw.gateway.trace.layout import CycleFlag
from pdgw.gateway.trace.place import rings, run_directory
from pdgw.gateway.trace.reader import Cycle, Frame, RingReader
from pdgw.gateway.trace.writer import PREVIOUS
from pdgw.profidrive.frame import CYCLIC_PORT
from pdgw.profinet.ethernet import header

PLC: Final = "plc"
"""The interface of the PLC's frames in captures."""
_NO_ADDRESS = ("0.0.0.0", CYCLIC_PORT)
_TARGET, _SOURCE = slice(0, 6), slice(6, 12)

Packet = tuple[int, LinkType, str, bytes]
"""Monotonic time, link type, interface, bytes."""


def chosen_ring(name: str | None, directory: Path | None = None) -> Path:
    """The ring of a path or a gateway's name; without one that of the only gateway that runs, else the only one there is.

    GatewayError lists what can be chosen.
    """
    if name is not None and (os.sep in name or Path(name).is_file()):
        return Path(name)
    found = rings(directory)
    if name is not None:
        fitting = [path for path in found if path.name.removesuffix(".ring") == name]
    else:
        fitting = [path for path in found if not path.name.endswith(PREVIOUS)]
        if len(fitting) > 1:
            fitting = [path for path in fitting if _is_written(path)] or fitting
    if len(fitting) == 1:
        return fitting[0]
    place = directory or run_directory() or "no run directory"
    names = ", ".join(path.name.removesuffix(".ring") for path in found) or "none"
    if name is not None:
        raise GatewayError(f"--ring {name}: not found, expected a path or one of these in {place}: {names}")
    why = "several ring files" if fitting else "no ring file of a gateway"
    raise GatewayError(f"{why}: give --ring a path or one of these in {place}: {names}")


def _is_written(path: Path) -> bool:
    with RingReader(path) as reader:
        return is_alive(reader)


def is_alive(reader: RingReader) -> bool:
    """The daemon still runs."""
    if reader.ended:
        return False
    try:
        os.kill(reader.process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True  # it belongs to another process
    return True


def captured(ring: Path, seconds: float, configuration: str) -> bytes:
    """The last seconds of a ring as the bytes of such a file with another text of the configuration; errors as of ``save``."""
    try:
        with RingReader(ring) as reader, tempfile.TemporaryDirectory(prefix="pdgw-") as directory:
            newest = reader.cycles(at_most=1)
            file = Path(directory) / "capture.pcapng"
            begin = newest[0].time_ns - int(seconds * SECOND) if newest else None
            save(reader, file, begin, configuration=configuration)
            return file.read_bytes()
    except OSError as error:
        raise GatewayError(f"not enough space for a temporary file ({error.strerror or error})") from error


def save(
    reader: RingReader,
    path: Path,
    begin_ns: int | None = None,
    end_ns: int | None = None,
    configuration: str | None = None,
) -> int:
    """Write what a ring has between two monotonic times; the number of packets. GatewayError when the file cannot be written.

    ``configuration``: the text that goes with it, None for the gateway's own.
    """
    cycles = [cycle for cycle in reader.cycles() if _within(cycle.time_ns, begin_ns, end_ns)]
    frames = [frame for frame in reader.frames() if _within(frame.time_ns, begin_ns, end_ns)]
    count = 0
    with writing(path):
        writer = PcapngWriter(path, reader.layout.configuration if configuration is None else configuration)
        try:
            for time_ns, link, name, data in packets(reader, cycles, frames):
                writer.write(link, name, reader.wall_ns(time_ns), data)
                count += 1
        finally:
            writer.close()
    return count


def _within(time_ns: int, begin_ns: int | None, end_ns: int | None) -> bool:
    return (begin_ns is None or time_ns >= begin_ns) and (end_ns is None or time_ns <= end_ns)


def packets(reader: RingReader, cycles: Sequence[Cycle], frames: Sequence[Frame]) -> Iterator[Packet]:
    """Both buses in the order of time."""
    buses = reader.layout.buses
    can = (
        (frame.time_ns, LinkType.CAN_SOCKETCAN, buses[frame.bus], can_packet(frame.identifier, frame.data))
        for frame in frames
    )
    ethernet = _profinet(cycles) if reader.layout.places.kind == "profinet" else _udp(reader, cycles)
    return heapq.merge(ethernet, can, key=itemgetter(0))


def _udp(reader: RingReader, cycles: Sequence[Cycle]) -> Iterator[Packet]:
    plc, here = _address(reader.peer), (_host(reader.layout.address[0]), CYCLIC_PORT)
    for cycle in cycles:
        if cycle.flags & CycleFlag.FRESH:
            yield cycle.time_ns, LinkType.ETHERNET, PLC, udp_packet(plc, here, cycle.received)
        if cycle.flags & CycleFlag.ANSWERED and cycle.received:  # before the first frame there is no PLC to answer
            yield _answered(cycle), LinkType.ETHERNET, PLC, udp_packet(here, plc, cycle.sent)


def _profinet(cycles: Sequence[Cycle]) -> Iterator[Packet]:
    """The device sends on its own timer: a frame to the controller is as the cycle left it, with the last one's counter."""
    for cycle in cycles:
        if cycle.flags & CycleFlag.FRESH and cycle.sent:
            yield (
                cycle.time_ns,
                LinkType.ETHERNET,
                PLC,
                header(cycle.sent[_SOURCE], cycle.sent[_TARGET]) + cycle.received,
            )
        if cycle.flags & CycleFlag.ANSWERED and cycle.sent:
            yield _answered(cycle), LinkType.ETHERNET, PLC, cycle.sent


def _answered(cycle: Cycle) -> int:
    return cycle.time_ns + (cycle.response_us or 0) * US


def _address(peer: str) -> tuple[str, int]:
    host, _, port = peer.rpartition(":")
    return (_host(host), int(port)) if port.isdigit() else _NO_ADDRESS


def _host(text: str) -> str:
    parts = text.split(".")
    return text if len(parts) == 4 and all(part.isdigit() for part in parts) else _NO_ADDRESS[0]
