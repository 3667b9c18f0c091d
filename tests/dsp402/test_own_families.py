"""Drive families of the user: a TOML file beside the configuration."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

import pdgw
from pdgw.dsp402.drive_type import Dsp402Error
from pdgw.dsp402.identification import overlay
from pdgw.gateway.configuration.file import config_text, load_config, parse_config
from pdgw.gateway.errors import GatewayError
from tests.support.cli import pdgw as command

OWN = 'title = "Mine"\nsources = ["manual"]\n[match]\nvendor_id = 0x7777\n[units]\nvelocity = "rpm"\n'
CONFIG = '[can]\ninterface = "virtual"\n[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = 1\nfamily = "./mine.toml"\n'


@pytest.fixture(autouse=True)
def no_family_stays(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    def forget() -> None:
        for found in (overlay.overlays, overlay.all_families, overlay.families_of):
            found.cache_clear()

    monkeypatch.setattr(overlay, "_added", {})
    forget()
    yield
    monkeypatch.undo()
    forget()


@pytest.fixture
def own(tmp_path: Path) -> Path:
    path = tmp_path / "mine.toml"
    path.write_text(OWN)
    return path


def test_an_added_family_is_found_by_name_and_identity(own: Path) -> None:
    assert overlay.overlay_for(0x7777, 1) is None
    assert overlay.families_of(0x7777) == ()
    added = pdgw.add_family(own)
    assert overlay.overlay("mine") is added
    assert overlay.overlay_for(0x7777, 1) is added
    assert overlay.families_of(0x7777) == ("mine",)
    assert pdgw.add_family(str(own)) == added


def test_the_data_sheet_of_a_family_is_beside_its_file(own: Path) -> None:
    own.write_text('eds = "mine.eds"\n' + OWN)
    assert pdgw.add_family(own).eds_path == own.with_name("mine.eds")


def test_a_family_that_cannot_be_added_is_refused(own: Path) -> None:
    pdgw.add_family(own)
    own.write_text(OWN.replace("Mine", "Other"))
    with pytest.raises(Dsp402Error, match="another file name: there is a family mine already"):
        pdgw.add_family(own)
    with pytest.raises(Dsp402Error, match=r"none\.toml.*a file that can be read \(No such file"):
        pdgw.add_family(own.with_name("none.toml"))
    wrong = own.with_name("wrong.toml")
    wrong.write_text(OWN + "colour = 3")
    with pytest.raises(Dsp402Error, match=r"overlay wrong: units\.colour: unknown key"):
        pdgw.add_family(wrong)


def test_the_configuration_names_the_file_of_a_family(own: Path, tmp_path: Path) -> None:
    path = tmp_path / "gateway.toml"
    path.write_text(CONFIG)
    axis = load_config(path).axis[0]
    assert axis.family_name == "mine"
    assert parse_config(config_text(load_config(path))).axis[0].family == str(own)
    path.write_text(CONFIG.replace("mine", "none"))
    with pytest.raises(GatewayError, match=r"gateway\.toml:7: \[\[axis\]\] number 1 family .*none\.toml.*No such file"):
        load_config(path)


def test_pdgw_drives_shows_the_family_of_a_file(own: Path) -> None:
    result = command("drives", str(own))
    assert result.returncode == 0
    assert "mine: Mine" in result.stdout
