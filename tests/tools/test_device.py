"""``pdgw device`` on a bus of simulated devices: save, compare, write."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from pdgw.ds301.bus.interfaces import open_bus
from pdgw.peers.bus import INTERFACE, ServedBus
from pdgw.peers.drive import SimulatedDrive
from tests.support.cli import pdgw

CONFIG = """
[can]
interface = "{interface}"
channel = "{channel}"
[[axis]]
do_id = 1
node_id = 5
telegram = 1
sdo_timeout_ms = 60000
"""


def test_a_saved_device_is_compared_written_and_stored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    file, dcf = tmp_path / "gateway.toml", tmp_path / "drive.dcf"
    with ServedBus(0) as hub, SimulatedDrive(open_bus(INTERFACE, hub.channel), 5) as drive:
        text = CONFIG.format(interface=INTERFACE, channel=hub.channel)
        file.write_text(text)
        saved = pdgw("device", "save", str(file), "1", "-o", str(dcf))
        again = pdgw("device", "save", str(file), "1", "-o", str(dcf))
        file.write_text(f'{text}dcf = "drive.dcf"\n')
        checked, same = pdgw("drives", str(dcf)), pdgw("device", "compare", str(file), "1")
        drive.do(lambda node: node.values.update({(0x6085, 0): 77, (0x6094, 1): 9}))
        differs = pdgw("device", "compare", str(file), "1")
        as_json = pdgw("device", "compare", str(file), "1", "--json")
        assert as_json.stdout, as_json.stderr
        document = json.loads(as_json.stdout)
        declined = pdgw("device", "write", str(file), "1", text="n\n")
        held = [drive.node.values[0x6085, 0], drive.node.values[0x6094, 1]]
        written = pdgw("device", "write", str(file), "1", "--store", "--yes")
        stored = [drive.node.stored[0x6085, 0], drive.node.stored[0x6094, 1]]
        nothing = pdgw("device", "write", str(file), "1")
    assert (saved.returncode, saved.stderr) == (
        0,
        f'next: dcf = "{dcf}" in the table of DO 1, pdgw device compare {file} 1\n',
    )
    assert saved.stdout == f"{dcf}: 29 values of node 5\n"
    assert (again.returncode, again.stderr) == (1, f"error: -o {dcf}: the file exists; name a new one\n")
    assert checked.returncode == 0
    assert (same.returncode, same.stdout) == (0, "drive.dcf: 29 values, 0 of them differ\n")
    assert differs.returncode == 1
    assert "29 values, 2 of them differ" in differs.stdout
    assert "6085h     Quick Stop Deceleration" in differs.stdout
    assert document[0] == {
        "object": "6094h.1",
        "name": "Numerator",
        "file": "1",
        "device": "9",
    }
    assert (declined.returncode, held) == (1, [77, 9])
    assert "error: nothing is written" in declined.stderr
    assert written.returncode == 0, written.stderr
    assert "2 values written and read back\nstored\n" in written.stdout
    assert "6094h.1: may act after a restart only; switch the device off and on" in written.stdout
    assert stored == [1000, 1]
    assert nothing.stdout == "drive.dcf: the device has all of its 29 values\n"


def test_a_bit_rate_that_lss_does_not_have_is_refused_before_the_bus_is_opened(tmp_path: Path) -> None:
    refused = pdgw("bus", "assign", "5", "--new-bitrate", "300000")
    allowed = "1000000, 800000, 500000, 250000, 125000, 50000, 20000, 10000"
    assert (refused.returncode, refused.stderr) == (1, f"error: --new-bitrate 300000: allowed: {allowed}\n")
    file = tmp_path / "gateway.toml"
    text = CONFIG.format(interface="virtual", channel="a").replace("[can]", '[[can]]\nname = "a"')
    file.write_text(f'{text}can = "a"\n[[can]]\nname = "b"\ninterface = "virtual"\nchannel = "b"\n')
    several = pdgw("bus", "assign", "5", str(file))
    assert several.stderr == f"error: {file} has several buses; name one by --interface and --channel\n"
