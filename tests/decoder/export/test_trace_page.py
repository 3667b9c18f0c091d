"""The HTML trace: self-contained, everything of the recording in it, and its script does what it says (run by node)."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from pdgw.gateway.base.errors import GatewayError
from pdgw.tools.decoder.export.trace_page import TracePage
from pdgw.tools.decoder.timeline.entries import Anomaly, AnomalyKind
from pdgw.tools.recording.recordings import Part, write_page
from tests.support.axis.recorded import RecordedRig, speed
from tests.support.buses import PATIENCE_S

needs_node = pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")


@pytest.fixture
def faulty() -> RecordedRig:
    rig = speed()
    rig.node.model.inject(7)
    rig.step(30)
    return rig


@pytest.fixture
def page(faulty: RecordedRig, tmp_path: Path) -> str:
    file = tmp_path / "trace.html"
    write_page(faulty.open(tmp_path), Part(), file)
    return file.read_text()


def data(page: str) -> dict[str, Any]:
    found = re.search(r'<script id="data" type="application/json">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    document: dict[str, Any] = json.loads(found[1])
    return document


def script(page: str) -> str:
    found = re.search(r'<script id="code">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    return found[1]


def node(*parts: str) -> Any:
    done = subprocess.run(
        ["node", "-"], input="\n".join(parts), capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout) if done.stdout.strip() else None


def test_page_is_self_contained(page: str) -> None:
    assert not re.search(r"https?://|<link|\bsrc=|@import|url\(", page)


def test_curves_words_and_entries_are_those_of_the_recording(page: str) -> None:
    found = data(page)
    (panel,) = found["panels"]
    curves = {curve["name"]: curve for curve in panel["curves"]}
    assert set(curves) == {"NSOLL_A", "NIST_A"}
    assert panel["unit"] == "%"
    assert max(curves["NSOLL_A"]["values"]) == pytest.approx(100 * 0x1000 / 0x4000)
    assert all(a != b for a, b in zip(curves["NIST_A"]["values"], curves["NIST_A"]["values"][1:], strict=False))
    assert {state for _, _, state in panel["spans"]} == {"operation", "fault", "off"}
    assert {word["name"] for word in found["words"]} == {"STW1", "ZSW1", "Controlword", "Statusword"}
    anomalies = [entry for entry in found["entries"] if entry["anomaly"]]
    assert any("EMCY: node 5: 2310h" in entry["text"] for entry in anomalies)
    assert [entry["time"] for entry in found["entries"]] == sorted(entry["time"] for entry in found["entries"])


def test_no_text_of_a_capture_ends_the_script(tmp_path: Path) -> None:
    page = TracePage("</script><script>alert(1)", 0)
    page.take(Anomaly(0, 1, AnomalyKind.EMERGENCY, "</script><!-- x"))
    page.write(tmp_path / "x.html")
    text = (tmp_path / "x.html").read_text()
    assert data(text)["title"] == "</script><script>alert(1)"
    assert data(text)["entries"][0]["text"].endswith("</script><!-- x")
    assert text.count("</script>") == 2
    with pytest.raises(GatewayError, match=r"--html .*cannot be written"):
        page.write(tmp_path / "no" / "x.html")


@needs_node
def test_hovering_shows_words_with_bits_and_values(page: str) -> None:
    found = data(page)
    on = next(entry["time"] for entry in found["entries"] if "047Eh -> 047Fh +ON" in entry["text"])
    code = f"process.stdout.write(JSON.stringify(stateAt({json.dumps(found)}, 1, {on + 0.1})))"
    lines = node(script(page), code)
    assert lines[0].endswith("axis 1")
    assert any(re.match(r"NIST_A \d+\.\d\d %", line) for line in lines)
    assert "STW1 047Fh ON NO_COAST_STOP NO_QUICK_STOP ENABLE_OPERATION" in "\n".join(lines)
    assert any(line.startswith("Statusword ") and "OPERATION_ENABLED" in line for line in lines)


@needs_node
def test_zooming_keeps_the_time_under_the_cursor_and_stays_inside(page: str) -> None:
    code = """process.stdout.write(JSON.stringify([
        zoomed([0, 10], [0, 10], 4, 0.5), zoomed([2, 7], [0, 10], 4, 100), moved([2, 4], [0, 10], -5), moved([2, 4], [0, 10], 50),
        lastBefore([1, 2, 2, 3], 2), lastBefore([1], 0), tickStep(10), tickStep(0.001),
        seenAfter("ArrowLeft", [2, 7], [0, 10]), seenAfter("Home", [2, 7], [0, 10]),
        seenAfter("x", [2, 7], [0, 10]) === undefined]))"""
    assert node(script(page), code) == [
        [2, 7],
        [0, 10],
        [0, 2],
        [8, 10],
        2,
        -1,
        2,
        pytest.approx(0.0002),
        [1.5, 6.5],
        [0, 10],
        True,
    ]


@needs_node
def test_the_timeline_about_an_anomaly_is_what_a_click_shows(page: str) -> None:
    found = data(page)
    emcy = next(entry for entry in found["entries"] if "EMCY" in entry["text"])
    code = f"process.stdout.write(JSON.stringify(around({json.dumps(found['entries'])}, 1, {emcy['time']})))"
    shown = node(script(page), code)
    assert shown["entries"][shown["at"]]["time"] == emcy["time"]
    assert any("Statusword" in entry["text"] and "+FAULT" in entry["text"] for entry in shown["entries"])
