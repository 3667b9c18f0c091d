"""The ring of the flight recorder and the codec of its values."""

from __future__ import annotations

import enum
import errno
import importlib
import os
import signal
import stat
import subprocess
import sys
import textwrap
import time
import typing
from collections.abc import Iterator
from dataclasses import is_dataclass
from pathlib import Path

import pytest

from pdgw.dsp402.states import State
from pdgw.gateway.axis.values import FaultRecord
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.base.run_directory import prepared, rings, run_directory
from pdgw.gateway.trace import pcapng
from pdgw.gateway.trace.json_values import HOMES, from_json, recorded_class, to_json
from pdgw.gateway.trace.reader import Frame, Parser, RingReader
from pdgw.gateway.trace.recorder import FlightRecorder
from tests.support.gateways.daemon import Plc, axis, configuration, drive_of, world_of
from tests.support.gateways.recorded_daemon import recorded

# -- a recording is read as it was written, whatever happens to its files ---------------------------------------------


BOTH = axis(1) + axis(3, telegram_number=9)


def ring(plc: Plc) -> FlightRecorder:
    found = plc.daemon.recorder
    assert found is not None
    return found


def turn(plc: Plc) -> None:
    plc.enable()
    plc.turn(0x2000)


def test_a_ring_has_frames_words_values_and_reasons(tmp_path: Path) -> None:
    with recorded(configuration(BOTH), tmp_path) as plc:
        turn(plc)
        reader = RingReader(ring(plc).path)
        cycle = reader.cycles()[-1]
        assert cycle.flags & ~pcapng.WHOLE == pcapng.FRESH | pcapng.CONNECTED | pcapng.ANSWERED
        assert reader.value(cycle, 0, "feedback", "velocity_actual") == 3000
        assert (reader.value(cycle, 0, "feedback", "statusword") or 0) & 0x6F == 0x27
        assert reader.value(cycle, 0, "command", "controlword") == 0x0F
        assert reader.value(cycle, 0, "command", "unknown") is None
        assert [reader.reason(cycle, place) for place in (0, 1)] == ["", Reason.NO_CONTROL.name]
        assert list(reader.setpoints(cycle, 0) or ()) == [0x047F, 0x2000]
        assert list(reader.actuals(cycle, 0) or ()) == [plc.value("ZSW1"), plc.value("NIST_A")]
        assert len(reader.setpoints(cycle, 1) or ()) == 8
        assert cycle.wall_ns == pytest.approx(world_of(plc.daemon).loop.wall() * 1e9, abs=5e7)
        assert [(item.do_id, item.telegram) for item in reader.layout.objects] == [(1, 1), (3, 9)]
        assert "[[axis]]" in reader.configuration
        assert plc.daemon.cycles == reader.newest_cycle
        drive_of(plc.daemon).inject(7)
        plc.until(lambda: drive_of(plc.daemon).model.state is State.FAULT, "fault")
        plc.until(lambda: reader.value(reader.cycles(at_most=1)[0], 0, "decided", "faults"), "recorded")
        assert reader.value(reader.cycles(at_most=1)[0], 0, "decided", "faults") == 1
        assert not reader.ended
    assert reader.ended
    assert plc.daemon.recorder is not None
    assert not plc.daemon.recorder.lost


def test_cycles_are_selected_by_their_number(tmp_path: Path) -> None:
    with recorded(configuration(axis(1)), tmp_path) as plc:
        plc.exchange(50)
        reader = RingReader(ring(plc).path)
        newest = reader.newest_cycle
        numbers = [cycle.number for cycle in reader.cycles()]
        assert numbers == list(range(1, newest + 1))
        assert [cycle.number for cycle in reader.cycles(after=newest - 2)] == numbers[-2:]
        assert [cycle.number for cycle in reader.cycles(at_most=3)] == numbers[-3:]
        assert [cycle.number for cycle in reader.cycles(after=10, upto=12)] == [11, 12]
        plc.exchange()
        assert [cycle.number for cycle in reader.cycles(after=newest)] == list(range(newest + 1, plc.daemon.cycles + 1))


def test_the_oldest_segments_are_deleted_and_each_can_be_read_alone(tmp_path: Path) -> None:
    text = "[trace]\nenabled = false\nseconds = 1\n"
    with recorded(configuration(axis(1) + text), tmp_path) as plc:
        turn(plc)
        plc.exchange(500)
        reader = RingReader(ring(plc).path)
        cycles = reader.cycles()
        assert 1.0 < (cycles[-1].time_ns - cycles[0].time_ns) / 1e9 < 1.3
        assert 10 < len(reader.segments()) < 18
        for segment in reader.segments():
            alone = RingReader(segment)
            first = alone.cycles()[0]
            assert list(alone.setpoints(first, 0) or ()) == [0x047F, 0x2000]
            assert all(cycle.steps[0].is_sent for cycle in alone.cycles())


def test_secrets_are_not_in_a_recording(tmp_path: Path) -> None:
    config = configuration(axis(1), can='[can]\ninterface = "virtual"\nchannel = "world"\napp_token = "s3cret"\n')
    with recorded(config, tmp_path) as plc:
        plc.exchange()
        reader = RingReader(ring(plc).path)
    assert b"s3cret" not in b"".join(path.read_bytes() for path in reader.segments())
    assert 'app_token = "..."' in reader.configuration


def test_a_change_of_telegram_begins_another_segment(tmp_path: Path) -> None:
    with recorded(configuration(axis(1)), tmp_path) as plc:
        plc.until(lambda: plc.state() == 0x40, "online")
        reader = RingReader(ring(plc).path)
        plc.daemon.change_telegram(plc.daemon.axes[0], 2)
        world_of(plc.daemon).loop.run_for(10 * plc.daemon.cycle_ns)
        assert reader.newest_cycle == plc.daemon.cycles
        assert [item.telegram for item in reader.layout.objects] == [2]
        assert not reader.replaced


@pytest.mark.parametrize("error", [errno.ENOSPC, errno.EIO])
def test_full_memory_loses_cycles_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: int) -> None:
    with recorded(configuration(axis(1)), tmp_path) as plc:
        turn(plc)
        write, count = os.write, 0

        def full(descriptor: int, data: bytes) -> int:
            nonlocal count
            count += 1
            if count % 2:
                raise OSError(error, os.strerror(error))
            return write(descriptor, data[: len(data) // 2])

        monkeypatch.setattr(os, "write", full)
        plc.exchange(20)
        monkeypatch.undo()
        assert plc.value("NIST_A") == 0x2000
        assert ring(plc).lost == count >= 20
        plc.exchange()
        reader = RingReader(ring(plc).path)
        assert reader.newest_cycle == plc.daemon.cycles
        assert len(reader.cycles()) == plc.daemon.cycles - count


def test_short_cycles_are_written_together_and_at_once_with_an_event(tmp_path: Path) -> None:
    with recorded(configuration(axis(1), transport="cycle_time_ms = 1\nwatchdog_factor = 255"), tmp_path) as plc:
        turn(plc)
        reader = RingReader(ring(plc).path)
        behind = set()
        for _ in range(100):
            plc.exchange()
            behind.add(plc.daemon.cycles - reader.newest_cycle)
        assert behind == set(range(10))
        for word in (0x047E, 0x047F):
            plc.endpoint.set(0, {"STW1": word})
            reason = plc.daemon.axes[0].reason
            while plc.daemon.axes[0].reason is reason:
                plc.exchange()
            assert plc.daemon.cycles == reader.newest_cycle
        plc.silent = True
        plc.exchange(5)
        assert plc.daemon.cycles == reader.newest_cycle
    assert not ring(plc).lost
    assert [cycle.number for cycle in reader.cycles()] == list(range(1, plc.daemon.cycles + 1))
    frames = [
        item for path in reader.segments() for item in Parser("").feed(path.read_bytes()) if isinstance(item, Frame)
    ]
    assert [frame.wall_ns for frame in frames] == sorted(frame.wall_ns for frame in frames)


def test_a_truncated_segment_leaves_the_axis_in_operation(tmp_path: Path) -> None:
    with recorded(configuration(axis(1)), tmp_path) as plc:
        turn(plc)
        (segment,) = RingReader(ring(plc).path).segments()
        os.truncate(segment, 0)
        plc.exchange(500)
        assert plc.value("NIST_A") == 0x2000


def test_files_are_for_owner_and_group_and_another_gateway_takes_another_folder(tmp_path: Path) -> None:
    with recorded(configuration(axis(1)), tmp_path) as plc, recorded(configuration(axis(1)), tmp_path) as other:
        first, second = ring(plc).path, ring(other).path
        assert (first.name, second.name) == ("test.ring", "test-2.ring")
        (segment,) = RingReader(first).segments()
        assert stat.S_IMODE(segment.stat().st_mode) == 0o440
        assert stat.S_IMODE((tmp_path / "test.lock").stat().st_mode) == 0o600


def test_what_an_earlier_run_left_is_kept_once(tmp_path: Path) -> None:
    for cycles in (10, 20, 30):
        with recorded(configuration(axis(1)), tmp_path) as plc:
            plc.exchange(cycles)
            reader = RingReader(ring(plc).path)
            assert not reader.ended
            before = reader.newest_cycle
        assert reader.ended
    assert sorted(path.name for path in tmp_path.glob("*.ring")) == ["test.previous.ring", "test.ring"]
    reader = RingReader(tmp_path / "test.previous.ring")
    assert reader.newest_cycle < before
    assert rings(tmp_path)[0].name == "test.ring"


@pytest.mark.parametrize(
    "spoil",
    [
        lambda data: b"",
        lambda data: data[:100],
        lambda data: b"x" * len(data),
        lambda data: data.replace(b'"version": 2', b'"version": 3'),
        lambda data: data.replace(b'{"": "Description', b'["": "Description', 1),
        lambda data: data.replace(b'{"": "Description', b'{"": "os.system '),
    ],
)
def test_a_file_that_is_not_a_recording_or_damaged_is_refused_in_one_line(tmp_path: Path, spoil: object) -> None:
    with recorded(configuration(axis(1)), tmp_path) as plc:
        plc.exchange()
        (segment,) = RingReader(ring(plc).path).segments()
    assert callable(spoil)
    path = tmp_path / "spoilt.pcapng"
    path.write_bytes(spoil(segment.read_bytes()))
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


# -- a gateway in another process, killed ----------------------------------------------------------------------------------

WRITER = """
    import sys
    from pathlib import Path
    from tests.support.gateways.daemon import axis, configuration
    from tests.support.gateways.recorded_daemon import recorded
    with recorded(configuration(axis(1)), Path(sys.argv[1])) as plc:
        print("begins", flush=True)
        while True:
            plc.exchange()
"""
SEEN = os.pathsep.join(filter(None, sys.path))
"""What this process imports, the tests and the build they are run on, for the other one."""


@pytest.mark.e2e
def test_kill_9_leaves_all_written_cycles_readable(tmp_path: Path) -> None:
    arguments = [sys.executable, "-c", textwrap.dedent(WRITER), str(tmp_path)]
    with subprocess.Popen(
        arguments, stdout=subprocess.PIPE, text=True, env=os.environ | {"PYTHONPATH": SEEN}
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "begins\n"
        reader = RingReader(tmp_path / "test.ring")
        newest = 0
        while newest < 200:
            assert process.poll() is None
            cycles = reader.cycles(after=newest)
            assert [cycle.number for cycle in cycles] == list(range(newest + 1, newest + 1 + len(cycles)))
            newest += len(cycles)
            time.sleep(0)
        process.send_signal(signal.SIGKILL)
        process.wait()
        assert [cycle.number for cycle in reader.cycles()] == list(range(1, reader.newest_cycle + 1))
        assert not reader.ended


# -- every class in a recorded value is found by its name ---------------------------------------------------------


def test_every_class_within_a_recorded_value_is_found_by_its_name() -> None:
    waiting = [found for home in HOMES for found in _own(home)]
    seen: set[type] = set()
    while waiting:
        kind = waiting.pop()
        if kind not in seen:
            seen.add(kind)
            waiting += [inner for hint in _hints(kind) for inner in _classes(hint)]
    assert [kind for kind in seen if recorded_class(kind.__name__) is not kind] == []


def test_a_recorded_value_without_a_later_field_gets_its_default() -> None:
    known = FaultRecord(7, 0x2310, 0, "over-current", 1)
    document = to_json(known)
    del document["is_bare"]
    assert from_json(document) == known


def _own(module: str) -> Iterator[type]:
    """The dataclasses that a module defines."""
    for found in vars(importlib.import_module(module)).values():
        if isinstance(found, type) and is_dataclass(found) and found.__module__ == module:
            yield found


def _hints(kind: type) -> list[object]:
    return list(typing.get_type_hints(kind).values()) if is_dataclass(kind) else []


def _classes(hint: object) -> Iterator[type]:
    """The dataclasses and enums in a type."""
    if isinstance(hint, type) and (is_dataclass(hint) or issubclass(hint, enum.Enum)):
        yield hint
    for inner in typing.get_args(hint):
        yield from _classes(inner)
