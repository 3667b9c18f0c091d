"""A configuration is a value: reading one, sound or damaged, leaves every table of the process as it was."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Set
from pathlib import Path

import pytest

from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.configuration.file import load_config

FAMILY = 'title = "Mine"\nsources = ["manual"]\n[match]\nvendor_id = 0x7777\n[units]\nvelocity = "rpm"\n'
FILE = """
[can]
interface = "virtual"

[[telegram]]
number = 1200
like = 1
setpoints = ["STW1", "NSOLL_A", "USER"]
actuals = ["ZSW1", "NIST_A"]

[[axis]]
do_id = 1
node_id = 1
telegram = 1200
family = "./mine.toml"
"""
DAMAGES = {
    "a value": "heartbeat_ms = 0\n",
    "an unknown key": "colour = 1\n",
    "a missing data sheet": 'eds = "none.eds"\n',
    "two layouts": FILE[FILE.index("[[telegram]]") : FILE.index("[[axis]]")].replace(', "USER"', ""),
    "a whole that does not fit": "[[encoder]]\ndo_id = 1\nnode_id = 2\ntelegram = 83\n",
}


def tables() -> dict[str, object]:
    """Every table of the modules of this package, as text."""
    found: dict[str, object] = {}
    for module_name, module in sorted(sys.modules.items()):
        if module_name.split(".")[0] == "pdgw":
            for name, value in vars(module).items():
                place = f"{module_name}.{name}"
                if isinstance(value, Mapping | Set | list) and not name.startswith("__"):
                    found[place] = repr(value)
    return found


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "mine.toml").write_text(FAMILY)
    path = tmp_path / "gateway.toml"
    path.write_text(FILE[: FILE.index("[[telegram]]")] + "[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = 1\n")
    load_config(path)  # what is computed once
    path.write_text(FILE)
    return path


def test_reading_a_configuration_changes_no_table(path: Path) -> None:
    before = tables()
    assert len(before) > 300
    first, second = load_config(path), load_config(path)
    assert first == second
    assert tables() == before


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_file_leaves_nothing(path: Path, damage: str) -> None:
    before = tables()
    path.write_text(FILE + DAMAGES[damage])
    with pytest.raises(GatewayError):
        load_config(path)
    assert tables() == before
    path.write_text(FILE.replace(', "USER"', ""))
    (path.parent / "mine.toml").write_text(FAMILY.replace("Mine", "Corrected"))
    corrected = load_config(path)
    assert corrected.axis[0].chosen.setpoints.names == ("STW1", "NSOLL_A")
    assert corrected.families.own[0].title == "Corrected"
