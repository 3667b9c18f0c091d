"""The means of the tests: how many have processes or the wall clock, their processor time, and what they say while they wait."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from tests import room_tests
from tests.conftest import is_real
from tests.cpu_times import SLOWEST, lines
from tests.support import processes
from tests.support.buses import process_checks, wait_for
from tests.support.gateways.socket_plc import SocketPlc
from tests.support.processes import wait_for_text

AT_MOST = 40
ON_THEIR_OWN = {"tour", "can"}
"""Folders that ``make test`` does not run."""


def test_number_of_tests_with_processes_or_real_time_is_limited(request: pytest.FixtureRequest) -> None:
    real = [item for item in request.session.items if is_real(item) and item.path.parent.name not in ON_THEIR_OWN]
    assert len(real) <= AT_MOST, (
        "too many tests are marked e2e or browser: run it in virtual time (World), in this process (tests/support/cli.py), "
        "or beside what another test has started"
    )


def test_the_table_has_the_sum_then_the_folders_then_the_slowest_tests_the_longest_first() -> None:
    seconds = {
        "tests/a/test_x.py::test_one": 0.5,
        "tests/b/test_y.py::test_two[/::3]": 2.0,
        "tests/a/test_x.py::test_three": 1.0,
    }
    assert [line.split() for line in lines(seconds)] == [
        ["3.50", "s", "3", "tests"],
        ["2.00", "s", "1", "tests", "in", "tests/b"],
        ["1.50", "s", "2", "tests", "in", "tests/a"],
        ["2.00", "s", "tests/b/test_y.py::test_two[/::3]"],
        ["1.00", "s", "tests/a/test_x.py::test_three"],
        ["0.50", "s", "tests/a/test_x.py::test_one"],
    ]
    many = {f"tests/test_z.py::test_{number}": 1.0 for number in range(100)}
    assert len(list(lines(many))) == 2 + SLOWEST


def test_every_room_has_its_tests_and_their_seconds() -> None:
    assert set(room_tests.TESTS) == room_tests.rooms()
    paths = " ".join([room_tests.ALWAYS, *room_tests.TESTS.values()]).split()
    assert [path for path in paths if not (room_tests.ROOT / path).exists()] == []
    kept = dict.fromkeys(room_tests.ALWAYS.split(), 1.0)
    first, *others = room_tests.lines(kept, [])
    assert first == f"any room                  3 s  pytest {room_tests.ALWAYS}"
    assert all("  -  pytest tests/" in line for line in others)


def test_waiting_for_a_text_ends_with_the_process_and_shows_all_logs_of_its_folder(tmp_path: Path) -> None:
    (tmp_path / "chapter").mkdir()
    (tmp_path / "chapter" / "devices.log").write_text("port 4000 is in use\n")
    log = tmp_path / "demo.log"
    with log.open("w") as output, subprocess.Popen(["sh", "-c", "echo story; exit 3"], stdout=output) as process:
        process.wait()
        wait_for_text("story", log, process)
        with pytest.raises(AssertionError, match=r"(?s)status 3 without 'enable'.*port 4000 is in use.*story"):
            wait_for_text("enable", log, process)


def test_timed_out_wait_reports_the_last_observation() -> None:
    seen: list[int] = []
    with pytest.raises(AssertionError, match="not within 0 s: three, seen 1"):
        wait_for(lambda: seen.append(1), lambda: f"three, seen {len(seen)}", 0)


def wait_as_plc(condition: Callable[[], bool], what: str) -> None:
    SocketPlc(("127.0.0.1", 1), [1]).until(condition, what)


@pytest.mark.parametrize("wait", [wait_for, wait_as_plc])
def test_failed_start_ends_every_wait_and_shows_the_logs(
    wait: Callable[[Callable[[], bool], str], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(processes, "COMMAND", ("sh", "-c", "echo port 4000 is in use; exit 3"))
    with (
        pytest.raises(AssertionError, match="run plant: ended with status 3") as failed,
        processes.running("run", "plant", log=tmp_path / "log"),
    ):
        wait(lambda: False, "the answer")
    assert failed.value.__notes__ == ["the logs:\nlog:\nport 4000 is in use\n"]
    assert not process_checks
