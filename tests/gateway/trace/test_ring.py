"""The ring of the flight recorder: what is read is what was written, whatever the writer does meanwhile."""

from __future__ import annotations

import mmap
import os
import signal
import stat
import struct
import subprocess
import sys
import textwrap
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from pdgw.dsp402.states import State
from pdgw.gateway.daemon import Daemon
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.reasons import Reason
from pdgw.gateway.trace import truncation
from pdgw.gateway.trace.layout import (
    FRAME,
    PAGE,
    CycleFlag,
    ObjectFlag,
    sized,
)
from pdgw.gateway.trace.place import prepared, rings, run_directory
from pdgw.gateway.trace.reader import RingReader
from pdgw.gateway.trace.recorder import FlightRecorder
from pdgw.gateway.trace.writer import RingFile
from tests.support.gateways.daemon import Plc, axis, configuration, drive_of, running, world_of
from tests.support.readers.ring import LAYOUT, LIMIT, record


def test_the_last_records_are_read_as_they_were_written(tmp_path: Path) -> None:
    ring = RingFile(tmp_path, LAYOUT, LIMIT)
    with RingReader(ring.path) as reader:
        assert reader.cycles() == []
        for number in range(1, 6):
            ring.cycle(record(number))
        assert [cycle.sequence for cycle in reader.cycles()] == [1, 2, 3, 4, 5]
        for number in range(6, 41):
            ring.cycle(record(number))
            ring.frame(0, 0x180 + number, bytes((number,) * (number % 9)), number & 1, number)
        cycles, frames = reader.cycles(), reader.frames()
        assert [cycle.sequence for cycle in cycles] == list(range(25, 41))
        assert [frame.sequence for frame in frames] == list(range(28, 36))
        for cycle in cycles:
            number = cycle.sequence
            assert (cycle.time_ns, cycle.response_us) == (number, number)
            assert (cycle.received, cycle.sent) == (number.to_bytes(12, "big"), number.to_bytes(10, "big"))
            (sample,) = cycle.objects
            assert (sample.velocity, sample.position, sample.statusword) == (number, -number, number)
            assert (reader.reason(sample.reason), sample.flags, sample.faults) == ("NO_PLC", 3, 9)
        for frame in frames:
            number = frame.time_ns
            assert (frame.identifier, frame.data, frame.sent) == (
                0x180 + number,
                bytes((number,) * (number % 9)),
                bool(number & 1),
            )
        assert [cycle.sequence for cycle in reader.cycles(after=38)] == [39, 40]
        assert [cycle.sequence for cycle in reader.cycles(at_most=3)] == [38, 39, 40]
        assert [frame.sequence for frame in reader.frames(after=20, at_most=2)] == [34, 35]
    ring.close()


def test_a_record_that_is_being_written_is_left_out(tmp_path: Path) -> None:
    ring = RingFile(tmp_path, LAYOUT, LIMIT)
    for number in range(1, 21):
        ring.cycle(record(number))
    with RingReader(ring.path) as reader, ring.path.open("r+b") as file, mmap.mmap(file.fileno(), 0) as raw:
        size = ring.layout.cycle.size
        # Number 21 replaces number 5: the writer has cleared the number and is in the middle.
        struct.pack_into("@Q", raw, ring.layout.cycles_offset + 5 * size, 0)
        assert [cycle.sequence for cycle in reader.cycles()] == [6, *range(7, 21)]
        # A number that is not the expected one is another turn's.
        struct.pack_into("@Q", raw, ring.layout.cycles_offset + 10 * size, 26)
        assert 10 not in [cycle.sequence for cycle in reader.cycles()]
    ring.close()


def test_a_record_changed_while_it_is_copied_is_left_out(tmp_path: Path) -> None:
    ring = RingFile(tmp_path, LAYOUT, LIMIT)
    for number in range(1, 17):
        ring.cycle(record(number))
    with RingReader(ring.path) as reader:

        class Moving:
            """A view that is copied before the writer continues."""

            def __init__(self, view: memoryview) -> None:
                self.view = view

            def __getitem__(self, part: slice) -> bytes:
                taken = bytes(self.view[part])
                for number in range(17, 20):
                    ring.cycle(record(number))
                return taken

            def release(self) -> None:
                self.view.release()

        reader._view = Moving(reader._view)  # type: ignore[assignment]
        assert [cycle.sequence for cycle in reader.cycles()] == list(range(4, 17))
    ring.close()


def test_the_file_is_for_owner_and_group_and_another_gateway_takes_another(tmp_path: Path) -> None:
    first = RingFile(tmp_path, LAYOUT, LIMIT)
    assert stat.S_IMODE(first.path.stat().st_mode) == 0o440
    assert stat.S_IMODE((tmp_path / "test.lock").stat().st_mode) == 0o600
    second = RingFile(tmp_path, LAYOUT, LIMIT)
    assert (first.path.name, second.path.name) == ("test.ring", "test-2.ring")
    first.close()
    second.close()


def test_what_an_earlier_run_left_is_kept_once(tmp_path: Path) -> None:
    for number in (1, 2, 3):
        ring = RingFile(tmp_path, LAYOUT, LIMIT)
        for _ in range(number):
            ring.cycle(record(number))
        with RingReader(ring.path) as reader:
            assert not reader.ended
            ring.close()
            assert reader.ended
    assert sorted(path.name for path in tmp_path.glob("*.ring")) == ["test.previous.ring", "test.ring"]
    with RingReader(tmp_path / "test.previous.ring") as reader:
        assert reader.newest_cycle == 2
    assert rings(tmp_path)[0].name == "test.ring"


def test_memory_is_bounded_and_records_are_powers_of_two() -> None:
    wanted = replace(LAYOUT, cycles=100_000, frames=300_000)
    cycles, frames = sized(wanted, 4 << 20)
    assert cycles * LAYOUT.cycle.size + frames * FRAME.size <= 4 << 20
    assert cycles & (cycles - 1) == frames & (frames - 1) == 0
    assert sized(wanted, 1 << 30) == (131072, 524288)


def test_a_value_that_fits_no_field_is_counted_and_leaves_no_record(tmp_path: Path) -> None:
    ring = RingFile(tmp_path, LAYOUT, LIMIT)
    ring.cycle([*record(1)[:-1], 256])
    ring.cycle(record(2))
    with RingReader(ring.path) as reader:
        assert [cycle.time_ns for cycle in reader.cycles()] == [2]
    assert ring.failures == 1
    ring.close()


@pytest.mark.parametrize(
    "spoil",
    [
        lambda data: b"",
        lambda data: data[:100],
        lambda data: b"x" * len(data),
        lambda data: data[: PAGE + 4000],
        lambda data: data[:8] + b"\x02" + data[9:],
        lambda data: data[:PAGE] + b"[" + data[PAGE + 1 :],
        lambda data: data[:16] + b"\xff\xff" + data[18:],
    ],
)
def test_a_file_that_is_no_ring_or_damaged_is_refused_in_one_line(tmp_path: Path, spoil: object) -> None:
    ring = RingFile(tmp_path, LAYOUT, LIMIT)
    ring.close()
    assert callable(spoil)
    path = tmp_path / "spoilt.ring"
    path.write_bytes(spoil(ring.path.read_bytes()))
    with pytest.raises(GatewayError) as caught:
        RingReader(path)
    assert len(str(caught.value).splitlines()) == 1


def test_the_run_directory_is_the_service_managers_or_the_users(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RUNTIME_DIRECTORY", f"{tmp_path}/run:{tmp_path}/other")
    assert run_directory() == tmp_path / "run"
    (tmp_path / "private").mkdir()
    (tmp_path / "run").symlink_to("private")  # what systemd makes of RuntimeDirectory= with DynamicUser=
    assert prepared(run_directory() or tmp_path) == tmp_path / "private"
    monkeypatch.delenv("RUNTIME_DIRECTORY")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert run_directory() == tmp_path / "pdgw"
    assert prepared(tmp_path / "pdgw").is_dir()
    (tmp_path / "file").touch()
    with pytest.raises(GatewayError, match="flight recorder"):
        prepared(tmp_path / "file")
    (tmp_path / "link").symlink_to(tmp_path / "pdgw")
    with pytest.raises(GatewayError, match="not a directory"):
        prepared(tmp_path / "link")
    if os.getuid():
        monkeypatch.setattr("os.getuid", lambda: 4711)
    else:
        os.chown(tmp_path / "pdgw", 4711, -1)
    with pytest.raises(GatewayError, match="belongs to another user"):
        prepared(tmp_path / "pdgw")


@pytest.mark.parametrize("mode", [0o770, 0o757, 0o1777])
def test_a_directory_in_which_others_may_write_is_rejected(tmp_path: Path, mode: int) -> None:
    directory = tmp_path / "pdgw"
    directory.mkdir()
    directory.chmod(mode)
    with pytest.raises(GatewayError, match=rf"other users may write in it \(mode {mode:04o}\), allowed: 0750"):
        prepared(directory)


@pytest.mark.skipif(not truncation.AVAILABLE, reason="Linux only")
@pytest.mark.parametrize("size", [0, PAGE])
def test_a_truncated_ring_does_not_end_the_process(tmp_path: Path, size: int) -> None:
    ring = RingFile(tmp_path, LAYOUT, LIMIT)
    other = RingFile(tmp_path, LAYOUT, LIMIT)
    ring.cycle(record(1))
    os.truncate(ring.path, size)
    for number in range(2, 40):
        ring.cycle(record(number))
        ring.frame(0, 0x181, b"", 0, number)
        other.cycle(record(number))
    ring.set_clock(5)
    assert ring.truncated
    assert not other.truncated
    with RingReader(other.path) as reader:
        assert reader.newest_cycle == 38
    ring.close()
    other.close()


@pytest.mark.skipif(not truncation.AVAILABLE, reason="Linux only")
def test_a_bus_error_outside_a_ring_ends_the_process_as_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ring = RingFile(tmp_path, LAYOUT, LIMIT)
    restored = []
    monkeypatch.setattr(truncation, "_libc", SimpleNamespace(sigaction=lambda number, *_: restored.append(number)))
    truncation._on_bus_error(signal.SIGBUS, SimpleNamespace(contents=SimpleNamespace(address=8)), None)
    assert restored == [signal.SIGBUS]
    assert not ring.truncated
    monkeypatch.undo()
    ring.close()


# -- torture: a writer in another process, as fast as it can, and killed ---------------------------------------------------

WRITER = """
    import sys
    from pathlib import Path
    from tests.support.readers.ring import LAYOUT, LIMIT, record
    from pdgw.gateway.trace.writer import RingFile
    ring = RingFile(Path(sys.argv[1]), LAYOUT, LIMIT)
    ring.set_clock(-5)
    print(ring.path, flush=True)
    number = 0
    while True:
        number += 1
        ring.cycle(record(number))
        ring.frame(0, number & 0x7FF, number.to_bytes(8, "big"), 1, number)
"""
SEEN = os.pathsep.join(filter(None, sys.path))
"""What this process imports, the tests and the build they are run on, for the other one."""
ROUNDS = int(os.environ.get("PDGW_RING_ROUNDS", "300"))
"""So often at least the whole ring is read; many more for the long form."""


@pytest.mark.e2e
def test_no_reader_ever_sees_a_torn_record_and_kill_9_leaves_the_ring_readable(tmp_path: Path) -> None:
    arguments = [sys.executable, "-c", textwrap.dedent(WRITER), str(tmp_path)]
    with subprocess.Popen(
        arguments, stdout=subprocess.PIPE, text=True, env=os.environ | {"PYTHONPATH": SEEN}
    ) as process:
        assert process.stdout is not None
        path = Path(process.stdout.readline().strip())
        read = newest = 0
        with RingReader(path) as reader:
            rounds = 0
            # On a busy machine the reader may get many turns before the writer gets one: it reads until there was enough.
            while rounds < ROUNDS or ((read <= ROUNDS or newest < reader.layout.cycles) and rounds < 1000 * ROUNDS):
                rounds += 1
                assert process.poll() is None
                for cycle in reader.cycles():
                    number = cycle.sequence
                    low = number & 0xFFFF
                    assert (cycle.time_ns, int.from_bytes(cycle.received, "big")) == (number, number)
                    assert int.from_bytes(cycle.sent, "big") == number
                    assert cycle.objects[0][:4] == (number, -number, low, low)
                    read += 1
                    newest = max(newest, number)
                for frame in reader.frames():
                    assert int.from_bytes(frame.data, "big") == frame.sequence == frame.time_ns
                    read += 1
            process.send_signal(signal.SIGKILL)
            process.wait()
            last = reader.cycles()
            assert len(last) >= reader.layout.cycles - 1
            assert last[-1].sequence >= newest
            assert not reader.ended
            assert reader.wall_ns(1000) == 995
    assert read > ROUNDS


# -- the recorder of a daemon ------------------------------------------------------------------------------------------------


def recorded(daemon: Daemon, directory: Path) -> RingReader:
    recorder = FlightRecorder(daemon, directory, "test")
    daemon.services.append(recorder)
    assert recorder.path is not None
    return RingReader(recorder.path)


def test_a_daemons_ring_has_its_frames_words_values_and_reasons(tmp_path: Path) -> None:
    readers: list[RingReader] = []
    config = configuration(axis(1) + axis(3, telegram_number=9))
    with running(config, lambda daemon: readers.append(recorded(daemon, tmp_path))) as daemon:
        (reader,) = readers
        plc = Plc(daemon, [1, 9])
        plc.enable()
        plc.endpoint.set(0, {"STW1": 0x047F, "NSOLL_A": 0x2000})
        plc.until(lambda: plc.value("NIST_A") == 0x2000, "1500 rpm")
        cycle = reader.cycles()[-1]
        first, second = cycle.objects
        assert cycle.flags == CycleFlag.FRESH | CycleFlag.CONNECTED | CycleFlag.ANSWERED
        assert (first.velocity, first.statusword & 0x6F, first.controlword, first.reason) == (3000, 0x27, 0x0F, 0)
        assert first.flags == ObjectFlag.SETPOINTS | ObjectFlag.GOOD
        assert reader.reason(second.reason) == Reason.NO_CONTROL.name
        assert list(reader.setpoints(cycle, 0) or ()) == [0x047F, 0x2000]
        assert list(reader.actuals(cycle, 0) or ()) == [plc.value("ZSW1"), plc.value("NIST_A")]
        assert len(reader.setpoints(cycle, 1) or ()) == 8
        assert reader.wall_ns(cycle.time_ns) == pytest.approx(world_of(daemon).loop.wall() * 1e9, abs=5e7)
        plc.until(lambda: reader.peer.startswith("plc:"), "told who the PLC is")
        traced = [(item.do_id, item.telegram, item.position_mapped) for item in reader.layout.objects]
        assert traced == [(1, 1, False), (3, 9, True)]
        assert "[[axis]]" in reader.layout.configuration
        # The frames of the bus are there too, sent and received.
        kinds = {(frame.identifier, frame.sent) for frame in reader.frames()}
        assert {(0x201, True), (0x181, False), (0x701, False), (0x77F, True)} <= kinds
        assert daemon.cycles == reader.newest_cycle
        drive_of(daemon).inject(7)
        plc.until(lambda: drive_of(daemon).model.state is State.FAULT, "fault")
        plc.until(lambda: reader.cycles(at_most=1)[0].objects[0].flags & ObjectFlag.ACTIVE_FAULT, "recorded")
        assert reader.cycles(at_most=1)[0].objects[0].faults == 1
    assert reader.ended
    reader.close()


def test_another_telegram_begins_another_ring(tmp_path: Path) -> None:
    readers: list[RingReader] = []
    with running(configuration(axis(1)), lambda daemon: readers.append(recorded(daemon, tmp_path))) as daemon:
        plc = Plc(daemon, [1])
        plc.until(lambda: plc.state() == 0x40, "online")
        assert not readers[0].replaced
        daemon.change_telegram(daemon.axes[0], 2)
        world_of(daemon).loop.run_for(10 * daemon.cycle_ns)
        assert readers[0].replaced
        with RingReader(readers[0].path) as reader:
            assert [item.telegram for item in reader.layout.objects] == [2]
            assert reader.newest_cycle > 0
        assert not (tmp_path / "test.previous.ring").exists()
    readers[0].close()


@pytest.mark.skipif(not truncation.AVAILABLE, reason="Linux only")
def test_a_truncated_ring_leaves_the_axis_in_operation_and_a_new_one_begins(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    readers: list[RingReader] = []
    with running(configuration(axis(1)), lambda daemon: readers.append(recorded(daemon, tmp_path))) as daemon:
        plc = Plc(daemon, [1])
        plc.enable()
        plc.endpoint.set(0, {"STW1": 0x047F, "NSOLL_A": 0x2000})
        plc.until(lambda: plc.value("NIST_A") == 0x2000, "1500 rpm")
        path = readers[0].path
        readers[0].close()
        os.truncate(path, 0)
        cycles = daemon.cycles
        plc.until(lambda: path.stat().st_size > 0, "a new ring")
        plc.until(lambda: daemon.cycles > cycles + 500, "cycles")
        assert plc.value("NIST_A") == 0x2000
        assert "another program truncated" in caplog.text
        with RingReader(path) as reader:
            assert reader.newest_cycle > 0
