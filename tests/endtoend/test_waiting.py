"""What a test with processes says when it waits for something that does not come."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from tests.support.buses import wait_for
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
