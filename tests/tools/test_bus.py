"""``pdgw bus scan`` on buses as users have them."""

from __future__ import annotations

import json
from pathlib import Path
from subprocess import CompletedProcess

from pdgw.ds301.bus.port import open_bus
from pdgw.peers.bus import INTERFACE, ServedBus
from pdgw.peers.drive import SimulatedDrive
from tests.support import buses
from tests.support.cli import pdgw

_QUICK = ("--listen-s", "0.05", "--timeout-ms", "200")
_WHOLE = "usable with telegrams: 1, 2, 3,"
"""Said of a drive that has answered everything in time."""


def test_loopback_bus_is_scanned_with_text_and_json_output() -> None:
    with ServedBus(0) as hub:
        place = ("--interface", INTERFACE, "--channel", hub.channel)
        with SimulatedDrive(open_bus(INTERFACE, hub.channel), 5):

            def scan(told: str, *more: str) -> CompletedProcess[str]:
                """With the times of a quiet machine, on another one again and longer."""
                for timeout_ms in (500, 3000, 30_000):
                    words = ("--listen-s", "0.05", "--timeout-ms", str(timeout_ms), *more)
                    result = pdgw("bus", "scan", *place, *words)
                    if told in result.stdout:
                        break
                return result

            text = scan(_WHOLE)
            document = json.loads(scan('"1": ""', "--json").stdout)
    assert text.returncode == 0, text.stderr
    assert "node 5: drive 'ENGEL HBI'" in text.stdout
    assert _WHOLE in text.stdout
    (bus,) = document
    (node,) = bus["nodes"]
    assert (node["node_id"], node["profile"], node["family"], node["telegrams"]["1"]) == (5, 402, "engel", "")


def test_scan_of_a_configuration_reports_missing_nodes(tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    channel = buses.channel()
    file.write_text(
        f'[can]\ninterface = "virtual"\nchannel = "{channel}"\n[[axis]]\ndo_id = 3\nnode_id = 9\ntelegram = 1\n'
    )
    result = pdgw("bus", "scan", str(file), *_QUICK)
    assert result.returncode == 0, result.stderr
    assert "node 9" in result.stdout
    assert "DO 3 of the configuration is missing" in result.stdout


def test_a_written_configuration_replaces_no_file(tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    with ServedBus(0) as hub, SimulatedDrive(open_bus(INTERFACE, hub.channel), 5):
        words = ("bus", "scan", "--interface", INTERFACE, "--channel", hub.channel, "--write", str(file))
        result = pdgw(*words)
        again = pdgw(*words)
    assert result.returncode == 0, result.stderr
    assert result.stderr == f"{file}: written; next: pdgw config check {file}\n"
    assert "node_id = 5\ntelegram = 1\n" in file.read_text()
    assert (again.returncode, again.stderr) == (1, f"error: --write {file}: the file exists; name a new one\n")
    refused = pdgw("bus", "scan", str(file), "--write", str(tmp_path / "other.toml"))
    assert "describes the buses already; scan without a configuration" in refused.stderr


def test_an_interface_that_is_not_there_is_named() -> None:
    result = pdgw("bus", "scan", "--interface", "socketcan", "--channel", "can77", *_QUICK)
    assert result.returncode == 1
    assert "CAN interface: 'socketcan channel can77'" in result.stderr
