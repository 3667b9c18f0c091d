"""The first configuration of what a scan has found: it is valid as it is written."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pdgw.dsp402.units.scaling import find_scaling
from pdgw.dsp406.kinds import LINEAR
from pdgw.gateway.commissioning.scan import Sheet, draft, load_sheets
from pdgw.gateway.commissioning.telegram_check import lacks_by_telegram
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.devices import EncoderModel
from pdgw.gateway.configuration.environment import CanConfig
from pdgw.gateway.configuration.file import parse_config
from pdgw.gateway.errors import GatewayError
from pdgw.peers.drive import SHAPES
from pdgw.peers.drive.objects import EDS_PATH
from tests.gateway.commissioning.test_scan import BUS, Site

PLACE = CanConfig(interface="socketcan", channel="can1", bitrate=500_000)


@pytest.fixture
def site() -> Site:
    return Site()


def drafted(site: Site, sheets: tuple[Sheet, ...] = ()) -> tuple[str, GatewayConfig]:
    text = draft(PLACE, site.scan(sheets).values())
    return text, parse_config(text)


def test_drives_and_encoders_have_a_telegram_that_they_support(site: Site) -> None:
    site.world.drive(BUS, 5)
    site.world.encoder(BUS, 20)
    site.world.encoder(BUS, 21, device=LINEAR)
    text, config = drafted(site, sheets=tuple(load_sheets([EDS_PATH])))
    assert [(item.do_id, item.node_id, item.telegram) for item in config.objects] == [
        (1, 5, 1),
        (2, 20, 81),
        (3, 21, 81),
    ]
    assert [item.model for item in config.encoder] == [EncoderModel.ROTARY, EncoderModel.LINEAR]
    assert (config.axis[0].eds, config.can[0].bitrate, config.can[0].channel) == (EDS_PATH, 500_000, "can1")
    assert "# node 5: 'ENGEL HBI', usable with telegrams 1, 2, 3," in text


@pytest.mark.parametrize("name", sorted(name for name in SHAPES if name not in {"slow-sdo", "slow-boot", "csp"}))
def test_every_simulated_drive_with_a_speed_mode_has_a_valid_configuration(site: Site, name: str) -> None:
    site.world.drive(BUS, 7, shape=SHAPES[name])
    _, config = drafted(site)
    assert [axis.telegram for axis in config.axis] == [1]


def test_keys_of_unknown_units_are_comments(site: Site) -> None:
    site.world.drive(BUS, 7)
    (node,) = site.scan().values()
    assert node.drive is not None
    node.drive = replace(node.drive, scaling=find_scaling({}))
    node.lacks = lacks_by_telegram(node.drive)
    text = draft(PLACE, [node])
    assert [axis.telegram for axis in parse_config(text).axis] == [1]
    assert '# velocity_unit = "?" # of 60FFh' in text
    node.drive = replace(node.drive, modes={1: "profile position"})
    node.lacks = lacks_by_telegram(node.drive)
    assert [axis.telegram for axis in parse_config(draft(PLACE, [node])).axis] == [9]


def test_a_bus_without_a_usable_node_has_no_configuration(site: Site) -> None:
    site.world.drive(BUS, 7, shape=SHAPES["csp"])
    with pytest.raises(GatewayError, match="no drive and no encoder"):
        drafted(site)
