"""A telegram of the user's own in every command that reads a configuration, or a recording of a gateway that had it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from pdgw.profidrive.telegrams import TELEGRAMS
from tests.decoder.replay.runs import speeds
from tests.support.cli import pdgw
from tests.support.gateways.daemon import axis, configuration
from tests.support.gateways.recorded_daemon import recorded, recording

OWN = """
[[telegram]]
number = 1001
like = 2
setpoints = ["STW1", "USER", "NSOLL_B", "STW2"]
actuals = ["ZSW1", "NIST_B", "USER", "USER", "ZSW2"]
"""
PROFINET = '[transport]\ntype = "profinet"\ninterface = "eth0"\n'


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording of a run with the telegram; nothing of it is known to this process."""
    folder = tmp_path_factory.mktemp("run")
    with recorded(configuration(axis(1, telegram_number=1001) + OWN), folder) as plc:
        speeds(plc)
    assert 1001 not in TELEGRAMS
    return Path(recording(folder))


@pytest.fixture
def config(tmp_path: Path) -> str:
    path = tmp_path / "gateway.toml"
    path.write_text('[can]\ninterface = "virtual"\nchannel = "own"\n' + axis(1, telegram_number=1001) + OWN)
    return str(path)


def printed(*arguments: str) -> str:
    """The output of a command that succeeds."""
    done = pdgw(*arguments)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_recording_replays_without_a_difference(run: Path) -> None:
    assert "1001" in printed("replay", str(run))


def test_a_recording_is_decoded_by_its_own_configuration(run: Path) -> None:
    words = [json.loads(line) for line in printed("decode", str(run), "--json").splitlines()]
    units = [unit for record in words for unit in record["units"] if unit.get("telegram") == 1001]
    names = {tuple(unit["signals"]) for unit in units}
    assert names == {("STW1", "USER", "NSOLL_B", "STW2"), ("ZSW1", "NIST_B", "USER", "USER_2", "ZSW2")}
    assert printed("decode", str(run), "--filter", "user_2 == 0")


def test_a_recording_has_a_timeline(run: Path) -> None:
    assert "Operation Enabled" in printed("timeline", str(run))


def test_a_configuration_says_what_a_capture_has(run: Path, config: str) -> None:
    assert "axis 1 T1001 STW1" in printed("decode", str(run), "--config", config)


def test_the_map_has_its_words(config: str) -> None:
    found = printed("map", config, "--format", "csv")
    assert [name for name in ("USER", "USER_2", "NSOLL_B") if name not in found] == []
    assert "1001" in printed("map", config, "--format", "st")


def test_the_check_accepts_it(config: str) -> None:
    assert "ok, 1 axis" in printed("config", "check", config)


def test_the_device_description_has_its_submodule(config: str, tmp_path: Path) -> None:
    path = Path(config)
    path.write_text(path.read_text() + PROFINET)
    printed("map", config, "--gsdml", str(tmp_path))
    (description,) = tmp_path.glob("GSDML*.xml")
    assert "0x000103E9" in description.read_text()
