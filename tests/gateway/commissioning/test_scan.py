"""The scan of a bus writes nothing; the first configuration made of it is valid."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import can
import pytest

from pdgw.base.durations import MS
from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.communication import (
    CONSUMER_HEARTBEAT,
    DEFAULT_GATEWAY_NODE_ID,
    ERROR_CONTROL,
    NMT,
    PRODUCER_HEARTBEAT,
    SDO_REQUEST,
    SYNC_PERIOD,
)
from pdgw.ds301.pdo import PdoDirection
from pdgw.dsp402.identification.overlay import Overlay, QuirkKeys
from pdgw.dsp402.units.scaling import find_scaling
from pdgw.dsp406.kinds import LINEAR
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.commissioning.draft import draft
from pdgw.gateway.commissioning.scan import Expected, FoundNode, Scan, Sheet, expected_on, load_sheets
from pdgw.gateway.commissioning.telegram_check import lacks, lacks_by_telegram
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.devices import EncoderModel
from pdgw.gateway.configuration.environment import CanConfig
from pdgw.gateway.configuration.file import parse_config
from pdgw.peers.drive import SHAPES
from pdgw.peers.drive.model.shapes import SYNCHRONOUS
from pdgw.peers.drive.objects import EDS_PATH
from pdgw.peers.world import World
from pdgw.profidrive.telegrams import telegram
from tests.support.gateways.daemon import axis, configuration

# -- it finds what is there and says what is missing --------------------------------------------------------------


BUS = "bus"
_UPLOAD = 0x40
_UPLOAD_SEGMENT = 0x60
_ABORT = 0x80


class Site:
    """A bus in a world of its own, and everything the scan sent on it."""

    def __init__(self, node_id: int = DEFAULT_GATEWAY_NODE_ID) -> None:
        self.world = World()
        config = CanConfig(interface="virtual", channel=BUS, node_id=node_id)
        self.network = CanNetwork(self.world.loop, lambda: self.world.open_can(config), node_id=node_id)
        self.network.start()
        self.sent: list[can.Message] = []
        self.network.listeners.append(lambda message: None if message.is_rx else self.sent.append(message))

    def scan(self, sheets: tuple[Sheet, ...] = (), expected: dict[int, Expected] | None = None) -> dict[int, FoundNode]:
        scan = Scan(self.network, sheets, expected, timeout_s=1.0)
        return {node.node_id: node for node in self.world.loop.complete(scan.run)}


@pytest.fixture
def site() -> Site:
    return Site()


def test_every_node_is_found_with_its_identity_and_what_it_can_be_used_for(site: Site) -> None:
    site.world.drive(BUS, 5)
    site.world.encoder(BUS, 20)
    found = site.scan()
    assert list(found) == [5, 20]
    drive = found[5].drive
    assert drive is not None
    assert (found[5].profile, found[5].name, drive.family) == (402, "ENGEL HBI", "engel")
    assert found[5].vendor_id == load_sheets([EDS_PATH])[0].identity[0]
    assert "speed: 100 % = 3000 rpm = 60FFh 6000 (from 6080h, 6094h: 1/2 rpm)" in drive.scaling.lines
    assert [found[5].lacks[number] for number in (1, 3, 9, 100)] == [""] * 4
    assert "9 (cyclic synchronous velocity) is missing" in found[5].lacks[5], (
        "its modes have no cyclic synchronous velocity"
    )
    assert found[20].profile == 406
    assert found[20].lacks == dict.fromkeys((81, 82, 83, 84), "")


def test_nothing_is_written_and_no_service_but_the_upload_is_used(site: Site) -> None:
    drive = site.world.drive(BUS, 5)
    before = dict(drive.node.values)
    site.scan()
    assert drive.node.values == before
    assert len(site.sent) > 127
    for message in site.sent:
        assert message.arbitration_id & ~0x7F == SDO_REQUEST
        assert message.data[0] & 0xE0 in {_UPLOAD, _UPLOAD_SEGMENT, _ABORT}, message


@pytest.mark.parametrize("name", sorted(name for name in SHAPES if name != "slow-sdo"))
def test_what_a_shape_lacks_is_what_the_axis_machine_refuses(site: Site, name: str) -> None:
    site.world.drive(BUS, 7, shape=SHAPES[name])
    site.world.loop.run_for(20_000 * MS)  # the slowest has booted
    found = site.scan()[7]
    assert found.drive is not None
    assert found.lacks[1] == lacks(found.drive, telegram(1))
    known = found.drive.scaling.rated_speed_rpm is not None and found.drive.speed_mode is not None
    assert (not found.lacks[1]) == known, found.lacks[1]


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("engel", "is the gateway's heartbeat (1016h, 300 ms), then quick stop (6007h = 3)"),
        ("node-guarding", "is life guarding (100Ch, 100Dh, 300 ms)"),
        ("rpdo-timeout", "is the timeout of its RPDO (1400h/5,"),
        ("unguarded", "is nothing; pdgw run rejects it; set allow_unguarded = true"),
    ],
)
def test_scan_reports_what_stops_a_drive_when_the_gateway_dies(site: Site, name: str, expected: str) -> None:
    site.world.drive(BUS, 7, shape=SHAPES[name])
    (note,) = site.scan()[7].notes
    assert note.startswith(f"if the gateway dies, this device is stopped by {expected.removeprefix('is ')}")


KNOWN_TO_STOP = Overlay(name="test", title="test", sources=("this test",), quirks=QuirkKeys(sync_loss_periods=3))
_DSC = 'dsc = "speed"\nfollowing_window = 4096'


@pytest.mark.parametrize(
    ("telegram", "more", "has_period", "expected"),
    [
        (105, _DSC, True, "the loss of SYNC (3 periods of 4000 us, 1006h), then its own reaction"),
        (
            105,
            _DSC,
            False,
            "nothing; pdgw run rejects it; set allow_unguarded = true if something else stops the drive when the gateway fails",
        ),
        (
            1,
            "",
            True,
            "nothing; pdgw run rejects it; use a telegram with SYNC in a cyclic synchronous mode: "
            "drives of this family stop without SYNC",
        ),
        (1, "allow_unguarded = true", True, "nothing; pdgw run operates it because allow_unguarded = true"),
    ],
)
def test_the_loss_of_sync_counts_where_the_configured_telegram_has_it_and_the_family_is_known_to_stop(
    site: Site, monkeypatch: pytest.MonkeyPatch, telegram: int, more: str, has_period: bool, expected: str
) -> None:
    monkeypatch.setattr("pdgw.dsp402.identification.overlay.Families.of", lambda *_: KNOWN_TO_STOP)
    lacks = SYNCHRONOUS.lacks | {CONSUMER_HEARTBEAT, PRODUCER_HEARTBEAT}
    node = site.world.drive(BUS, 1, shape=replace(SYNCHRONOUS, lacks=lacks)).node
    if not has_period:
        node.entries.pop((SYNC_PERIOD, 0))
        node.indices.discard(SYNC_PERIOD)
    before = len(site.sent)
    config = configuration(axis(1, telegram_number=telegram, more=more))
    found = site.scan(expected=expected_on(config, config.can[0]))[1]
    assert f"if the gateway dies, this device is stopped by {expected.removeprefix('is ')}" in found.notes
    assert all(message.data[0] & 0xE0 in {_UPLOAD, _UPLOAD_SEGMENT, _ABORT} for message in site.sent[before:])


def test_a_data_sheet_that_fits_is_named_and_one_of_another_device_is_not_used(site: Site) -> None:
    site.world.drive(BUS, 5)
    site.world.drive(BUS, 6, shape=SHAPES["rpm"])
    found = site.scan(tuple(load_sheets([EDS_PATH])))
    assert found[5].eds == EDS_PATH
    assert found[6].eds is None
    assert "no data sheet belongs to this device" in found[6].notes


def test_a_configured_node_is_compared_with_what_is_there(site: Site) -> None:
    site.world.drive(BUS, 1)
    site.world.drive(BUS, 2, shape=SHAPES["rpm"])
    site.world.encoder(BUS, 3)
    site.world.drive(BUS, 9)
    config = configuration(
        axis(1, telegram_number=9, more="") + axis(2, more=f'eds = "{EDS_PATH}"') + axis(3, more="") + axis(4, more="")
    )
    found = site.scan(expected=expected_on(config, config.can[0]))
    assert found[1].notes[-1] == "DO 1 of the configuration, telegram 9: nothing is missing"
    assert "another device, pdgw run rejects it" in found[2].notes[0]
    assert "DO 3 of the configuration needs device profile 402; this device has another one" in found[3].notes
    assert found[4].notes == ["no answer to SDO (not heard): DO 4 of the configuration is missing"]
    assert "this node is not in the configuration" in found[9].notes


def test_a_stopped_node_is_heard_though_it_answers_no_sdo(site: Site) -> None:
    other = site.world.bus(BUS).join("other")

    def beat() -> None:
        other.send(ERROR_CONTROL + 9, b"\x04")
        site.world.loop.call_later(100 * MS, beat)

    beat()
    found = site.scan()
    assert (found[9].nmt_state, found[9].notes) == ("Stopped", ["no answer to SDO (Stopped)"])


@pytest.mark.parametrize(
    ("can_id", "data", "what"),
    [
        (ERROR_CONTROL + 127, b"\x05", "heartbeat of a gateway"),
        (NMT, b"\x01\x00", "NMT command"),
        (SDO_REQUEST + 5, bytes(8), "SDO request to node 5"),
        (PdoDirection.RPDO.cob_id(1, 5), bytes(2), "process data for node 5"),
    ],
)
def test_a_bus_with_a_master_is_not_disturbed(site: Site, can_id: int, data: bytes, what: str) -> None:
    site.world.drive(BUS, 5)
    other = site.world.bus(BUS).join("other")
    site.world.loop.call_later(500 * MS, lambda: other.send(can_id, data))
    with pytest.raises(GatewayError, match=what):
        site.scan()
    assert site.sent == []


def test_only_the_heartbeat_with_the_configured_node_id_is_that_of_a_gateway() -> None:
    site = Site(node_id=4)
    other = site.world.bus(BUS).join("other")
    site.world.loop.call_later(500 * MS, lambda: other.send(ERROR_CONTROL + 127, b"\x05"))
    assert list(site.scan()) == [127]
    site.world.loop.call_later(500 * MS, lambda: other.send(ERROR_CONTROL + 4, b"\x05"))
    with pytest.raises(GatewayError, match=r"heartbeat of a gateway \(node 4\)"):
        site.scan()


def test_a_folder_of_data_sheets_is_read_and_a_bad_one_is_named(tmp_path: Path) -> None:
    (tmp_path / "drive.eds").write_text(EDS_PATH.read_text("latin-1"), "latin-1")
    (tmp_path / "notes.txt").write_text("none")
    assert [sheet.path.name for sheet in load_sheets([tmp_path])] == ["drive.eds"]
    (tmp_path / "bad.DCF").write_text("none")
    with pytest.raises(CanopenError, match=r"bad\.DCF"):
        load_sheets([tmp_path])


# -- the first configuration --------------------------------------------------------------------------------------


PLACE = CanConfig(interface="socketcan", channel="can1", bitrate=500_000)


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


def test_node_with_the_node_id_of_the_gateway_is_named_and_moves_the_gateway(site: Site) -> None:
    site.world.drive(BUS, 127)
    text, config = drafted(site)
    assert (config.axis[0].node_id, config.can[0].node_id) == (127, 126)
    assert "this is the node-ID of the gateway, too: [can] node_id must be another one" in text
    other = Site(node_id=4)
    other.world.drive(BUS, 4)
    other.world.drive(BUS, 127)
    named = [node_id for node_id, node in other.scan().items() if "[can] node_id" in str(node.notes)]
    assert named == [4]


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
