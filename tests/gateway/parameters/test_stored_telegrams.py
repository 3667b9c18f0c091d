"""A stored telegram (P922) replaces that of the file, and whoever shows the frame says so."""

from __future__ import annotations

from pathlib import Path

import pytest

from pdgw.gateway.configuration.file import load_config
from pdgw.gateway.service.status import snapshot
from pdgw.gateway.store import DeviceParameters, ParameterStore, stored_parameters
from pdgw.tools.commands.commissioning.config import check
from pdgw.tools.commands.commissioning.map import map_
from pdgw.tools.output.status_text import status_lines
from tests.support.gateways.daemon import Plc, axis, running

NOTE = "DO 1: telegram 3 is stored (P922) and replaces telegram 1 of the configuration"
REMEDY = 'run "pdgw param write P922 1 --do 1"'


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A configuration with telegram 1; telegram 3 is stored."""
    path = tmp_path / "gateway.toml"
    path.write_text(
        'store = "store.json"\n[can]\ninterface = "virtual"\nchannel = "world"\n[transport]\ncyclic_port = 0\n'
        f"acyclic_port = 0\nstatus_port = 0\n[trace]\nenabled = false\n{axis(1)}"
    )
    select(tmp_path / "store.json", 3)
    return path


def select(store: Path, number: int) -> None:
    def change(parameters: DeviceParameters) -> None:
        parameters.drive_object(1).telegram = number

    ParameterStore(store, pytest.fail).update(change)


def test_gateway_reports_the_stored_telegram_at_the_start_and_in_status(
    file: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with running(load_config(file)) as daemon:
        Plc(daemon, [3]).enable()
        lines = " ".join(status_lines(snapshot(daemon), 400))
    assert NOTE in caplog.text
    assert NOTE in lines
    assert REMEDY in lines


def test_gateway_with_the_telegram_of_its_file_has_no_note(file: Path, caplog: pytest.LogCaptureFixture) -> None:
    select(file.with_name("store.json"), 1)
    with running(load_config(file)) as daemon:
        assert snapshot(daemon)["notes"] == []
    assert "P922" not in caplog.text


def test_map_shows_the_frame_that_the_gateway_uses(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    map_(file)
    shown = capsys.readouterr()
    assert "G1_XIST1" in shown.out
    assert NOTE in shown.err


def test_config_check_names_the_stored_telegram(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    check(file)
    assert NOTE in capsys.readouterr().out


def test_reading_a_damaged_store_leaves_the_file_as_it_is(tmp_path: Path) -> None:
    damaged = tmp_path / "store.json"
    damaged.write_text("{}")
    assert stored_parameters(damaged).telegrams == {}
    assert [item.name for item in tmp_path.iterdir()] == ["store.json"]
