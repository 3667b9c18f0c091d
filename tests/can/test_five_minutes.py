"""README's five minutes with a real drive on can0, word by word: the commands and the file are taken from there."""

from __future__ import annotations

import re
import shlex
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.configuration.defaults import STATUS_PORT
from pdgw.gateway.service.status_client import fetch
from tests.can.forked import Forked, forked
from tests.can.interfaces import Wire, ip, is_controller
from tests.support.buses import PATIENCE_S
from tests.support.processes import PATIENT

_README = (Path(__file__).parents[2] / "README.md").read_text("utf-8")
_CHAPTER = _README[_README.index("## Five minutes with a real drive on can0") :]
_CHAPTER = _CHAPTER[: _CHAPTER.index("\n## ")]
_CYCLE_MS = 50
"""Instead of 4: times that a slow machine keeps. Everything else is as it is written there."""


def command(start: str) -> list[str]:
    """The words of the one command of the chapter that begins so, without ``pdgw``."""
    (found,) = {"".join(text) for text in re.findall(rf"`({start}[^`]*)`|^ +({start}[^\n#]*)", _CHAPTER, re.MULTILINE)}
    words = shlex.split(found.strip())
    return words[1:] if words[0] == "pdgw" else words


def said(*words: str) -> str:
    """What a command prints that ends by itself."""
    with forked(*words, log=Path("said.log")) as process:
        assert process.wait(PATIENCE_S) == 0, process.text
        return process.text


def wait_for(condition: Callable[[], object], what: str, *processes: Forked) -> None:
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, "\n".join((what, *(item.text for item in processes)))
        time.sleep(0.1)


def axis() -> tuple[object, object]:
    """State and 606Ch of the running gateway's axis."""
    try:
        (shown,) = fetch(STATUS_PORT, PATIENCE_S)["axes"]
    except GatewayError:
        return "", 0
    return shown["drive_state"], shown["velocity"]


def press(plc: Forked, key: str, shown: tuple[object, object], *processes: Forked) -> None:
    """Press a key until the axis shows the state; press it again if the PLC timed out while it waited for a paused drive."""
    given_up = plc.text.count("not met")
    plc.type(key)

    def in_operation() -> bool:
        nonlocal given_up
        if plc.text.count("not met") > given_up:
            given_up += 1
            plc.type(key)
        return axis() == shown

    wait_for(in_operation, f"after {key}", *processes)


def test_the_five_minutes_of_the_readme_turn_a_drive(
    line: Wire, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    if is_controller(line.near):
        ip("set", line.near, "down")
        sudo, *bring_up = command("sudo ip link")
        assert sudo == "sudo"
        subprocess.run(bring_up, check=True, timeout=PATIENCE_S)
    (text,) = re.findall(r"```toml\n(.*?)```", _CHAPTER, re.DOTALL)
    smallest = re.sub(r"^   ", "", text, flags=re.MULTILINE)
    assert "cycle_time_ms = 4\n" in smallest
    slow = smallest.replace("cycle_time_ms = 4\n", f"cycle_time_ms = {_CYCLE_MS}\nwatchdog_factor = 250\n")
    Path("gateway.toml").write_text(slow + PATIENT)  # the axis is the last table
    simulator = ("sim", "drive", "--interface", "socketcan", "--channel", line.far)
    with (
        forked(*simulator, log=Path("drive.log")) as drive,
        forked(*command("pdgw run gateway.toml"), log=Path("gateway.log")) as gateway,
        forked(*command("pdgw sim plc"), "--cycle-ms", str(_CYCLE_MS), log=Path("plc.log")) as plc,
    ):
        everybody = drive, gateway, plc
        assert "gateway.toml: ok, 1 axis on can (socketcan can0)" in said(*command("pdgw config check"))
        wait_for(lambda: axis()[0] == "Switch On Disabled", "the drive is online", *everybody)
        wait_for(lambda: "e=enable" in plc.text, "the PLC's keys", *everybody)
        for key, shown in (("e", ("Operation Enabled", 0)), ("+", ("Operation Enabled", 600))):
            press(plc, key, shown, *everybody)
        assert "node 1 online" in said(*command("pdgw status"))
        assert "P922" in said("param", "read", "P922", "6041h")
        plc.type("ox")
        assert plc.wait(PATIENCE_S) == 0
        gateway.signal(signal.SIGTERM)
        assert gateway.wait(PATIENCE_S) == 0
        assert gateway.text.rstrip().endswith("stopped")
        assert "Traceback" not in gateway.text
