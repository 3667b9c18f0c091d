"""What a test with processes says when it waits for something that does not come."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support import processes
from tests.support.buses import process_checks, wait_for
from tests.support.gateways.socket_plc import SocketPlc
from tests.support.processes import wait_for_text


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
