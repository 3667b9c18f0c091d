"""What a cycle of the gateway takes, in counts, which no other work on the machine changes: bytecodes and calls into C, or the
instructions of a compiled gateway by callgrind.

The gateway has real sockets and ideal drives. Its clock stops while the gateway or anything else works. Only the gateway is
counted. ``python -m tests.long.bench.counting ROW [off]`` is the process that callgrind runs; ``off``: without recorder.
"""

from __future__ import annotations

import ctypes
import os
import platform
import re
import selectors
import shutil
import socket
import subprocess
import sys
import tempfile
import tomllib
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any, Final, NamedTuple, Protocol

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.bus.port import SocketPort
from pdgw.ds301.loop.readiness import READABLE, best_readiness
from pdgw.ds301.loop.system_loop import SystemLoop
from pdgw.gateway.base.identity import COMPILED, kind
from pdgw.gateway.base.platform import CanInterface, SystemPlatform
from pdgw.gateway.configuration.file import parse_config
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.links.profinet.io_device import ProfinetLink
from pdgw.gateway.trace.recorder import FlightRecorder
from pdgw.peers.controller.controller import IoController
from pdgw.peers.controller.exchange import ControllerExchange
from pdgw.peers.controller.project import Project
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.profidrive.telegrams import telegram
from pdgw.profinet.rpc.dcerpc import ACYCLIC_PORT
from pdgw.profinet.station import Identity, Station
from tests.long.bench.drives import IdealDrives
from tests.support.documents.parts import DOCS, write_part
from tests.support.gateways.daemon import POSITIONER
from tests.support.wire.ethernet import FakeEthernet
from tests.support.wire.profinet import DEVICE_IP, PLC_MAC

LIMITS: Final = Path(__file__).with_name("counts.toml")
_BEGIN_NS: Final = 10 * SECOND
_PHASE_NS: Final = 300 * MS
"""Counting begins this time after a whole second: all values are recorded once a second."""
_OPERATED_NS: Final = SECOND
_POLL_NS: Final = 20 * MS
_DELAY: Final = 0.4
"""Of a cycle, until the drives of a PROFINET row answer: their TPDOs do not come in the turn of the RPDOs."""
_WAKES_NS: Final = 2 * SECOND
_NEVER: Final = 1 << 62
_OFF, _ON = 0x047E, 0x047F
_STATE, _READY, _OPERATION = 0x4F, 0x01, 0x07


class Row(NamedTuple):
    """A gateway. ``cycles``: the number of those that are counted with bytecodes. Without PLC it is idle."""

    axes: int
    per_bus: int
    cycle_ms: float
    cycles: int
    telegram: int = 1
    link: str = "udp"


ROWS: Final = {
    "1 axis, 1 ms": Row(1, 3, 1, 200),
    "8 axes, 1 ms": Row(8, 3, 1, 50),
    "64 axes, 4 ms": Row(64, 3, 4, 10),
    "30 axes on one bus, 10 ms": Row(30, 30, 10, 10),
    "telegram 111, 4 ms": Row(1, 3, 4, 100, telegram=111),
    "PROFINET, 1 ms": Row(1, 3, 1, 200, link="profinet"),
    "PROFINET, 4 ms": Row(1, 3, 4, 100, link="profinet"),
    "idle": Row(8, 3, 4, 25, link=""),
}
INSTRUCTIONS: Final = ("1 axis, 1 ms", "8 axes, 1 ms", "64 axes, 4 ms", "30 axes on one bus, 10 ms")
"""Rows that callgrind counts for `make bench`."""
_INSTRUCTION_CYCLES: Final = 400


class Counter(Protocol):
    """Counts what runs after ``resume`` and until ``pause``."""

    def begin(self) -> None: ...

    def resume(self) -> None: ...

    def pause(self) -> None: ...

    def end(self) -> None: ...


class Bus:
    """A bus between one gateway and the drives: ``attach`` as a hub has it. ``delay``: of each frame of the drives."""

    def __init__(self, readers: selectors.BaseSelector, clock: Callable[[], int], delay: int) -> None:
        self.socket, self._other = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._other.setblocking(False)
        self._readers = readers
        self._clock = clock
        self._delay = delay
        self._delayed: deque[tuple[int, bytes]] = deque()

    def attach(self, receive: Callable[[bytes], None]) -> Callable[[bytes], object]:
        def take() -> None:
            try:
                while True:
                    receive(self._other.recv(64))
            except BlockingIOError:
                return

        self._readers.register(self._other, selectors.EVENT_READ, take)
        return self._send if self._delay else self._other.send

    def _send(self, frame: bytes) -> None:
        self._delayed.append((self._clock() + self._delay, frame))

    def poll(self, now: int) -> int:
        """Send what is due; when to call again."""
        while self._delayed and now >= self._delayed[0][0]:
            self._other.send(self._delayed.popleft()[1])
        return self._delayed[0][0] if self._delayed else _NEVER

    def shutdown(self) -> None:
        """Of python-can's buses."""
        self.socket.close()
        self._other.close()


class Cable(FakeEthernet):
    """An Ethernet interface whose frames wake the loop."""

    def start(
        self, on_real_time: Callable[[], None], on_other: Callable[[], None], on_link: Callable[[], None]
    ) -> None:
        super().start(on_real_time, on_other, on_link)
        self._signal, self._end = socket.socketpair()
        self.loop.add_reader(self._signal.fileno(), on_real_time, urgent=True)

    @property
    def ready(self) -> list[tuple[int, int]]:
        """As a descriptor."""
        return [(self._signal.fileno(), READABLE)] if self.real_time and self.listening else []

    def _received(self) -> None:
        """The loop calls it."""

    def close(self) -> None:
        super().close()
        self._signal.close()
        self._end.close()


class Plc:
    """Brings all axes into operation, then sends another setpoint in each cycle."""

    def __init__(self, row: Row) -> None:
        self.endpoint = PlcEndpoint([telegram(row.telegram)] * row.axes, round(row.cycle_ms * MS))
        self._cycles = 0
        self.operates = False
        self._value = next(name for name in ("NSOLL_A", "OVERRIDE") if name in self.endpoint.setpoints[0])

    def step(self) -> None:
        """The setpoints of the next cycle."""
        self._cycles += 1
        states = [0 if item is None else item["ZSW1"] & _STATE for item in self.endpoint.actuals]
        self.operates = all(state == _OPERATION for state in states)
        size = (self._cycles % 64 // 2 + 1) * 128
        for axis, state in enumerate(states):
            if not self._cycles % 10 or self.operates:
                word = _ON if state & _READY else _OFF
                value = size if self._cycles % 2 or self._value == "OVERRIDE" else -size
                self.endpoint.set(axis, {"STW1": word, self._value: value if self.operates else 0})


class UdpPlc(Plc):
    """Over UDP."""

    def __init__(self, row: Row, readers: selectors.BaseSelector) -> None:
        super().__init__(row)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._readers = readers
        self._period = round(row.cycle_ms * MS)
        self._due = 0

    def start(self, daemon: Daemon, now: int) -> None:
        """Send from now on."""
        self._daemon, self._due = daemon, now
        self._readers.register(self._socket, selectors.EVENT_READ, self._take)

    def _take(self) -> None:
        self.endpoint.receive(self._socket.recv(4096), self._daemon.loop.now())

    def poll(self, now: int) -> int:
        """Send what is due; when to call again."""
        if now >= self._due:
            self._due += self._period
            self.step()
            self._socket.sendto(self.endpoint.build(now), self._daemon.address)
        return self._due

    def close(self) -> None:
        self._readers.unregister(self._socket)
        self._socket.close()


class ProfinetPlc(Plc):
    """An IO controller."""

    def __init__(self, row: Row, cable: Cable) -> None:
        super().__init__(row)
        self._cable = cable
        self._period = round(row.cycle_ms * MS)
        self._due = 0

    def start(self, daemon: Daemon, now: int) -> None:
        """Connect."""
        assert isinstance(daemon.link, ProfinetLink)
        station = Station(Identity(PLC_MAC, 1, 1, "plc", "PLC"), "plc-1")
        modules = daemon.link.device.model.modules
        project = Project("press-1", modules, reduction_ratio=self._period // MS, data_hold=100)
        self._controller = IoController(station, project, DEVICE_IP)
        self._exchange = ControllerExchange(self.endpoint, self._controller)
        self._controller.start(now)
        self._due = now

    def poll(self, now: int) -> int:
        """Exchange what is due; when to call again."""
        controller, cable = self._controller, self._cable
        while cable.sent:
            address, data = cable.sent.popleft()
            if address is None:
                controller.on_frame(data, now)
            else:
                controller.on_datagram(data, (str(DEVICE_IP.address), ACYCLIC_PORT), now)
        if now >= self._due:
            self._due += self._period
            self._exchange.take(now)
            self.step()
            self._exchange.send()
        controller.poll(now)
        for target, frame in controller.outgoing():
            cable.arrive(target, bytes(frame))
        due = controller.next_deadline()
        return self._due if due is None else max(now + 1, min(due, self._due))

    def close(self) -> None:
        """Nothing to release."""


class _Counted(BaseException):
    """All is counted."""


class Machine(SystemPlatform):
    """A computer whose clock stops while anything works, and jumps to the next event if nothing does."""

    def __init__(self, row: Row, counter: Counter, cycles: int) -> None:
        self._time = [_BEGIN_NS]
        self._clock: Callable[[], int] = partial(list.__getitem__, self._time, 0)
        self._system = best_readiness()
        self.watch, self.close = self._system.watch, self._system.close
        self.loop = SystemLoop(self, self._clock)
        self._readers = selectors.DefaultSelector()
        self._counter = counter
        self._limit = cycles
        self._row = row
        delay = int(_DELAY * row.cycle_ms * MS) if row.link == "profinet" else 0
        self._buses = [Bus(self._readers, self._clock, delay) for _ in range(0, row.axes, row.per_bus)]
        self._drives = [
            IdealDrives(bus, min(row.per_bus, row.axes - number * row.per_bus), self._clock)
            for number, bus in enumerate(self._buses)
        ]
        self.cable = Cable(self.loop)
        self._plc: UdpPlc | ProfinetPlc | None = None
        if row.link:
            self._plc = UdpPlc(row, self._readers) if row.link == "udp" else ProfinetPlc(row, self.cable)
        self._plc_due = _NEVER
        self._poll_due = _BEGIN_NS
        self._begin_at = _NEVER
        self._first = -1
        """Number of cycles at the begin of the count."""
        self.cycles = 0
        self.wakes = 0
        """Of the loop, during the count."""

    def open_can(self, config: CanInterface) -> SocketPort:
        return SocketPort(self.loop, self._buses[int(str(config.channel))])  # type: ignore[arg-type]

    def run(self, daemon: Daemon) -> None:
        """Until all is counted."""
        self._daemon = daemon
        try:
            daemon.run()
        except _Counted:
            pass
        finally:
            if self._plc is not None:
                self._plc.close()
            self._readers.close()

    # -- readiness of the loop --------------------------------------------------------------------------------------------

    def wait(self, seconds: float) -> list[tuple[int, int]]:
        """All but the gateway works until the gateway has something to do."""
        if self._first >= 0:
            self._counter.pause()
            self.cycles = self._daemon.cycles - self._first
            if self.cycles >= self._limit:
                self._counter.end()
                self._first = -1
                raise _Counted
        asleep = self._time[0]
        until = asleep + int(seconds * SECOND)
        while not self._works() and self._time[0] < until:
            self._advance(until)
        self._begin()
        if self._first >= 0:
            self.wakes += self._time[0] > asleep
            self._counter.resume()
        return (self.cable.ready if self._row.link == "profinet" else []) + self._system.wait(0)

    def _works(self) -> bool:
        """The devices react; whether the gateway has something to do."""
        for key, _ in self._readers.select(0):
            key.data()
        return bool(self._system.wait(0)) or (self._row.link == "profinet" and bool(self.cable.ready))

    def _advance(self, until: int) -> None:
        """To the next event."""
        answers = min(bus.poll(self._time[0]) for bus in self._buses)
        now = self._time[0] = max(self._time[0], min(until, self._poll_due, self._plc_due, answers))
        for bus in self._buses:
            bus.poll(now)
        if now >= self._poll_due:
            self._poll_due += _POLL_NS
            for drives in self._drives:
                drives.poll(now)
        if self._plc is not None and now >= self._plc_due:
            self._plc_due = self._plc.poll(now)

    def _begin(self) -> None:
        """Begin to count in the right moment."""
        now, daemon = self._time[0], self._daemon
        if self._begin_at == _NEVER and all(axis.drive.generation for axis in daemon.axes):
            if self._plc is not None and self._plc_due == _NEVER:
                self._plc.start(daemon, now)
                self._plc_due = now
            if self._plc is None or self._plc.operates:
                self._begin_at = now + _OPERATED_NS
        is_phase = now % SECOND // MS == _PHASE_NS // MS
        if self._first < 0 and now >= self._begin_at and is_phase and not self.cycles:
            self._first = daemon.cycles
            self._counter.begin()


def configuration(row: Row) -> str:
    """Of the gateway of a row."""
    kind_ = 'type = "profinet"\ninterface = "eth1"\nstation_name = "press-1"\n' if row.link == "profinet" else ""
    ports = "" if kind_ else "watchdog_factor = 255\ncyclic_port = 0\nacyclic_port = 0\n"
    text = f"[transport]\ncycle_time_ms = {row.cycle_ms:g}\nstatus_port = 0\n{kind_}{ports}"
    for bus in range(0, row.axes, row.per_bus):
        number = bus // row.per_bus
        text += f'[[can]]\nname = "can{number}"\ninterface = "socketcan"\nchannel = "{number}"\n'
    for axis in range(row.axes):
        text += f'[[axis]]\ndo_id = {axis + 1}\nnode_id = {axis % row.per_bus + 1}\ncan = "can{axis // row.per_bus}"\n'
        # The ideal drive sends TPDOs only as answers.
        text += f"telegram = {row.telegram}\ntpdo_event_ms = 10000\nheartbeat_ms = 1000\n"
        text += POSITIONER if row.telegram == 111 else ""
    return text


def count(row: Row, counter: Counter, cycles: int, *, record: bool = True) -> Machine:
    """Count this number of cycles."""
    machine = Machine(row, counter, cycles)
    daemon = Daemon(parse_config(configuration(row)), machine, machine.cable if row.link == "profinet" else None)
    with tempfile.TemporaryDirectory() as folder:
        if record:
            daemon.services.append(FlightRecorder(daemon, Path(folder), "count"))
        machine.run(daemon)
    return machine


# Wakes of the loop.


class Uncounted:
    """Only the wakes are counted."""

    def begin(self) -> None: ...

    def resume(self) -> None: ...

    def pause(self) -> None: ...

    def end(self) -> None: ...


def wakes(row: Row) -> int:
    """Wakes a second that are not those of the cycles."""
    machine = count(row, Uncounted(), round(_WAKES_NS / (row.cycle_ms * MS)))
    return (machine.wakes - machine.cycles) * SECOND // _WAKES_NS


# Bytecodes and calls into C of a gateway that is not compiled.


class Bytecodes:
    """``recorder``: the bytecodes of the flight recorder."""

    def __init__(self) -> None:
        self.bytecodes = self.calls = self.recorder = 0

    def begin(self) -> None:
        """Nothing is to be prepared."""

    def resume(self) -> None:
        sys.setprofile(self._called)
        sys.settrace(self._entered)

    def pause(self) -> None:
        sys.settrace(None)
        sys.setprofile(None)

    def end(self) -> None:
        """All is counted."""

    def _entered(self, frame: FrameType, event: str, _: Any) -> Any:
        module = _module(frame)
        if not module.startswith("pdgw."):
            return None
        frame.f_trace_opcodes, frame.f_trace_lines = True, False
        return self._of_recorder if module.startswith("pdgw.gateway.trace") else self._executed

    def _executed(self, _: FrameType, event: str, __: Any) -> Any:
        self.bytecodes += event == "opcode"
        return self._executed

    def _of_recorder(self, _: FrameType, event: str, __: Any) -> Any:
        self.bytecodes += event == "opcode"
        self.recorder += event == "opcode"
        return self._of_recorder

    def _called(self, frame: FrameType, event: str, _: Any) -> None:
        self.calls += event == "c_call" and _module(frame).startswith("pdgw.")


def _module(frame: FrameType) -> str:
    """Generated functions have no module: they belong to their callers."""
    return str(frame.f_globals.get("__name__") or (frame.f_back or frame).f_globals["__name__"])


class Taken(NamedTuple):
    """Of a cycle: bytecodes, calls into C, percentage of the bytecodes that is the recorder's."""

    bytecodes: int
    calls: int
    recorder: int


def taken(row: Row) -> Taken:
    """What a cycle of a row takes, with the recorder."""
    counter = Bytecodes()
    count(row, counter, row.cycles)
    share = round(100 * counter.recorder / counter.bytecodes)
    return Taken(counter.bytecodes // row.cycles, counter.calls // row.cycles, share)


# Instructions of a compiled gateway.


class Callgrind:
    """Of the process that callgrind runs; ``library``: callgrind.c."""

    def __init__(self, library: str) -> None:
        made = ctypes.CDLL(library)
        self.begin, self.end = made.begin, made.end
        self.resume = self.pause = made.toggle


def missing() -> str:
    """Why instructions cannot be counted; empty: they can."""
    if kind() != COMPILED:
        return "instructions are those of a compiled gateway: make test COMPILED=1"
    absent = [program for program in ("valgrind", "cc") if shutil.which(program) is None]
    return f"not installed: {', '.join(absent)}" if absent else ""


def interpreter() -> str:
    """What the instructions depend on beside the gateway."""
    return f"{platform.python_implementation()} {platform.python_version()} {platform.machine()} {'-'.join(platform.libc_ver())}"


def _run(folder: str, *arguments: str) -> None:
    """Run a program that starts a Python, in a folder."""
    environment = os.environ | {"PYTHONHASHSEED": "0", "PYTHONSAFEPATH": "1", "PYTHONDONTWRITEBYTECODE": ""}
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, sys.path))
    subprocess.run(arguments, check=False, capture_output=True, env=environment, cwd=folder)


def _callgrind(folder: str, options: list[str], *arguments: str) -> tuple[int, int]:
    """Run a Python in a folder: its instructions, and how often it enters the interpreter's loop from C."""
    out = f"--callgrind-out-file={Path(folder) / 'out'}"
    _run(folder, "valgrind", "--tool=callgrind", out, *options, sys.executable, *arguments)
    text = "".join(dump.read_text() for dump in Path(folder).glob("out*"))
    totals = re.findall(r"^totals: (\d+)", text, re.MULTILINE)
    # A function has a number, and its name where it is first used.
    (loop,) = re.findall(r"\((\d+)\) _PyEval_EvalFrameDefault$", text, re.MULTILINE)
    entries = re.findall(rf"^cfn=\({loop}\).*\ncalls=(\d+)", text, re.MULTILINE)
    return sum(map(int, totals)), sum(map(int, entries))


class Compiled(NamedTuple):
    """Of a cycle: user instructions, and how often compiled code enters the interpreter's loop.

    One entry in each turn of the gateway's loop is that of ``Machine.wait``.
    """

    instructions: int
    entries: float


def compiled(name: str, *, record: bool = True) -> Compiled:
    """What a cycle of a row takes."""
    with tempfile.TemporaryDirectory() as folder:
        library, source = str(Path(folder) / "callgrind.so"), Path(__file__).with_name("callgrind.c")
        subprocess.run(["cc", "-shared", "-fPIC", "-o", library, str(source)], check=True)
        arguments = ("-m", __name__, name, library, *([] if record else ["off"]))
        total, entries = _callgrind(folder, ["--instr-atstart=no", "--collect-atstart=no"], *arguments)
    return Compiled(total // _INSTRUCTION_CYCLES, round(entries / _INSTRUCTION_CYCLES, 1))


def command(arguments: str) -> int:
    """User instructions of a command of ``pdgw`` without a gateway, whose modules an earlier call has compiled."""
    with tempfile.TemporaryDirectory() as folder:
        called = ("-X", f"pycache_prefix={folder}", "-m", "pdgw", *arguments.split())
        _run(folder, sys.executable, *called)
        return _callgrind(folder, [], *called)[0]


# The table of `make bench`, and the limits.


TITLES: Final = ("row", "bytecodes", "calls into C", "instructions", "entries of the interpreter", "recorder")
_CLOSE: Final = ("bytecodes", "calls", "instructions")
"""What a change that is not meant to cost anything leaves as it is."""
_KEYS: Final = ("bytecodes", "calls", "instructions", "entries", "recorder")
"""Of the columns after the first one."""
MEASURED: Final = DOCS / "measured" / "counts.txt"
PLACE: Final = ("verification.md", "share of the recorder")


def limits() -> dict[str, dict[str, Any]]:
    """The counts that a test allows: by version of Python and row, and by ``compiled``, interpreter and row."""
    return tomllib.loads(LIMITS.read_text(encoding="utf-8"))


def excess(found: Mapping[str, float], limit: Mapping[str, float]) -> dict[str, float]:
    """The counts that are more than 1 % above their limits or more than 3 % below; of shares and entries, those above."""
    bounds = {key: (0.97, 1.01) if key in _CLOSE else (0, 1) for key in found}
    return {
        key: found[key]
        for key, (low, high) in bounds.items()
        if not low * limit[key] <= found[key] <= high * limit[key]
    }


def known() -> dict[str, dict[str, float]]:
    """The limits of this build, by row; empty for an interpreter without any."""
    version = "{}.{}".format(*sys.version_info[:2])
    found = limits()["compiled"].get(interpreter(), {}) if kind() == COMPILED else limits().get(version, {})
    return dict(found)


def rows(found: dict[str, dict[str, float]]) -> Iterator[tuple[str, ...]]:
    """The lines of the table: of a gateway that is not compiled, or of a compiled one. ``found`` gets the counts."""
    for name, row in ROWS.items():
        if kind() != COMPILED:
            found[name] = taken(row)._asdict()
        elif name in INSTRUCTIONS and not missing():
            (on, entries), (off, _) = compiled(name), compiled(name, record=False)
            found[name] = {"instructions": on, "entries": entries, "recorder": round(100 * (on - off) / on)}
        else:
            continue
        yield _line(name, found[name])


def _line(name: str, counts: Mapping[str, float]) -> tuple[str, ...]:
    """A row of the table."""
    return name, *(f"{counts[key]}{' %' * (key == 'recorder')}" if key in counts else "" for key in _KEYS)


def write(found: Mapping[str, Mapping[str, float]]) -> None:
    """Make these counts the limits of this build, and write the documents that have them."""
    section = f'[compiled."{interpreter()}"]' if kind() == COMPILED else '["{}.{}"]'.format(*sys.version_info[:2])
    before, begun, rest = LIMITS.read_text(encoding="utf-8").partition(f"{section}\n")
    if not begun:
        raise ValueError(f"{LIMITS}: section {section} is missing")
    lines = (
        f'"{name}" = {{ {", ".join(f"{key} = {value}" for key, value in counts.items())} }}\n'
        for name, counts in found.items()
    )
    LIMITS.write_text(f"{before}{begun}{''.join(lines)}{rest[rest.index(chr(10) * 2) + 1 :]}", encoding="utf-8")
    write_documents()


def write_documents() -> None:
    """The table of the limits, and the sentence about the recorder."""
    MEASURED.write_text(measured(), encoding="utf-8")
    write_part(*PLACE, share_of_the_recorder())


def _builds() -> dict[str, dict[str, dict[str, float]]]:
    """The limits of each build."""
    known = limits()
    pure = {f"pure Python, CPython {name}": known[name] for name in known if name[0].isdecimal()}
    return pure | {f"compiled, {name}": counts for name, counts in known["compiled"].items()}


def measured() -> str:
    """Each build with its limits, in columns."""
    lines = ["What a cycle of the gateway takes, by tests/long/bench/counts.toml.", ""]
    for build, found in _builds().items():
        table = [TITLES, *(_line(name, counts) for name, counts in found.items())]
        columns = [column for column in zip(*table, strict=True) if any(column[1:])]
        widths = [max(map(len, column)) for column in columns]
        cells = ("  ".join(map(str.ljust, row, widths)).rstrip() for row in zip(*columns, strict=True))
        lines += [build, "", *cells, ""]
    return "\n".join(lines)


def share_of_the_recorder() -> str:
    """The sentence about the recorder's share of a cycle."""
    texts = []
    for build, found in _builds().items():
        shares = sorted(int(counts["recorder"]) for counts in found.values())
        unit = "bytecodes" if build.startswith("pure") else "instructions"
        span = " to ".join(map(str, dict.fromkeys((shares[0], shares[-1]))))
        texts.append(f"{span} % of the {unit} ({build})")
    return f"The flight recorder takes of a cycle {', and '.join(texts)}.\n"


if __name__ == "__main__":
    count(ROWS[sys.argv[1]], Callgrind(sys.argv[2]), _INSTRUCTION_CYCLES, record="off" not in sys.argv)
