"""A gateway on PROFINET that records itself in virtual time: replay and timeline."""

from __future__ import annotations

from pathlib import Path

import pytest

from pdgw.durations import MS
from pdgw.profidrive.frame import STATUS_RUN
from pdgw.tools.decoder.timeline.text import entry_lines
from tests.support.gateways.daemon import axis
from tests.support.gateways.profinet_daemon import OFF, configuration, parameterise_anew, plant
from tests.support.gateways.recorded_daemon import record, recording, replay_of
from tests.support.readers.timeline import own_timeline


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Enable, speed, OFF1, PLC in STOP, silence, release and a second connection that writes the parameters again."""
    folder = tmp_path_factory.mktemp("recorded")
    config = configuration(axis(1) + axis(2, telegram_number=9), folder / "store.json")
    with plant(config, data_hold=400, before=lambda daemon: record(daemon, folder)) as site:
        site.connect()
        site.run(100 * MS)
        site.enable(1, 0x1000)
        site.run(300 * MS)
        site.set(1, OFF, 0x1000)
        site.run(500 * MS)
        site.enable(1, 0x0800)
        site.run(100 * MS)
        assert site.plc.provider is not None
        site.plc.provider.data_status &= ~STATUS_RUN
        site.run(500 * MS)
        site.plc.provider.data_status |= STATUS_RUN
        site.enable(1, 0x0800)
        site.run(100 * MS)
        site.plc.silent = True
        site.run(300 * MS)
        site.plc.silent = False
        site.enable(1, 0x0800)
        site.plc.release(site.loop.now())
        site.run(500 * MS)
        site.connect()
        site.enable(1, 0x0800)
        site.run(100 * MS)
        site.set(1, OFF)
        site.run(300 * MS)
        site.enable(1, 0x0800)
        site.run(100 * MS)
        parameterise_anew(site)
        site.run(300 * MS)
    return folder


def printed(folder: Path) -> list[str]:
    """The timeline's lines."""
    found = own_timeline(recording(folder))
    return ["".join(entry_lines(entry, found.opening.begin_ns)) for entry in found.entries]


def test_a_recording_is_equal(recorded: Path) -> None:
    for result in replay_of(recorded):
        assert not result.differences
        assert result.steps > 500


def test_timeline_shows_relationships_stops_and_losses(recorded: Path) -> None:
    lines = printed(recorded)

    def has(*parts: str) -> int:
        return sum(all(part in line for part in parts) for line in lines)

    assert has("relationship of plc-1 and press-1 granted") == 2
    assert has("relationship of plc-1 and press-1 confirmed: cyclic data is valid") == 2
    assert has("relationship of plc-1 and press-1 ended") == 1
    assert has("relationship of plc-1 and press-1 parameterised again: cyclic data is not valid") == 1
    assert has("provider stop") == 1
    assert has("no frame of the PLC for more than 12 ms") == 1
    assert has("axis 1", "PLC lost: the gateway stops the drive") == 4, (
        "in STOP, in silence, after Release and PrmBegin"
    )
    assert has("axis 1", "diagnosis, slot 1.1, Communication error to the higher-level control system appears") == 2
    assert has("axis 2", "diagnosis, slot 2.1, Communication error to the higher-level control system appears") == 2
    assert has("STW1", "047Eh -> 047Fh", "-> executed") == 6
