"""A gateway on PROFINET recorded in virtual time: timeline and replay know it from the captures alone."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from pdgw.decoder.timeline.text import entry_lines
from pdgw.durations import MS
from pdgw.profidrive.frame import STATUS_RUN
from pdgw.recording.recordings import Known, Loaded, followed, known_from, load, look_ahead
from tests.support.gateways.daemon import axis
from tests.support.gateways.profinet_daemon import OFF, Plant, configuration, parameterise_anew, plant

RPDO1 = 0x201
ENABLED = b"\x0f\x00"
"""The Controlword in operation."""


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Plant, Path]]:
    """Enable, speed, OFF1, PLC in STOP, silence, release and a second connection that writes the parameters again."""
    folder = tmp_path_factory.mktemp("recorded")
    config = configuration(axis(1) + axis(2, telegram_number=9), folder / "store.json")
    with plant(config, data_hold=400) as site:
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
        yield site, folder


def told(site: Plant, folder: Path) -> list[tuple[float, str]]:
    """The timeline's lines with their seconds."""
    opening = look_ahead(site.write(folder), known_from(None, [], []), 0, lambda _: None)
    begin = opening.begin_ns
    return [((entry.time_ns - begin) / 1e9, "".join(entry_lines(entry, begin))) for entry in followed(opening)]


def opened(site: Plant, folder: Path, known: Known | None = None) -> Loaded:
    files = site.write(folder)
    return load(files, known or known_from(None, [], []), 0, lambda _: None)


def test_a_recording_is_equal_without_a_configuration(recorded: tuple[Plant, Path], tmp_path: Path) -> None:
    loaded = opened(recorded[0], tmp_path)
    assert [(item.do_id, item.telegram.number) for item in loaded.recording.axes] == [(1, 1), (2, 9)]
    for outcome in loaded.replay(first_only=True):
        assert not outcome.differences, outcome.differences[0]
        assert outcome.compared > 500


def test_a_changed_command_is_found(recorded: tuple[Plant, Path], tmp_path: Path) -> None:
    site = recorded[0]
    before = list(site.can)
    try:
        # Repeated in operation: nothing else changes at that time.
        sent = [i for i, item in enumerate(site.can) if item[1] == RPDO1 and ENABLED in item[2]]
        position = next(here for last, here in pairwise(sent) if site.can[last][2] == site.can[here][2])
        now, can_id, data = site.can[position]
        site.can[position] = (now, can_id, data.replace(ENABLED, b"\x07\x00"))
        outcome = opened(site, tmp_path).replay(first_only=True)[0]
    finally:
        site.can[:] = before
    (difference,) = outcome.differences
    assert (difference.what, difference.names) == ("RPDO1", ("Controlword",))


def test_a_changed_actual_value_is_found(recorded: tuple[Plant, Path], tmp_path: Path) -> None:
    site = recorded[0]
    before = list(site.frames)
    try:
        answers = [i for i, (_, frame) in enumerate(site.frames) if frame[16:20] == bytes.fromhex("88928001")]
        position = answers[len(answers) // 4]
        now, frame = site.frames[position]
        place = site.link.device.relation.provider.place((1, 2))[0]
        changed = bytearray(frame)
        changed[place + 1] ^= 0x40
        site.frames[position] = (now, bytes(changed))
        outcome = opened(site, tmp_path).replay(first_only=True)[0]
    finally:
        site.frames[:] = before
    (difference,) = outcome.differences
    assert (difference.what, difference.names) == ("actual values", ("ZSW1",))


def test_timeline_shows_relationships_stops_and_losses(recorded: tuple[Plant, Path], tmp_path: Path) -> None:
    lines = [text for _, text in told(recorded[0], tmp_path)]

    def has(*parts: str) -> int:
        return sum(all(part in line for part in parts) for line in lines)

    assert has("relationship of plc-1 and press-1 granted") == 2
    assert has("relationship of plc-1 and press-1 confirmed: cyclic data is valid") == 2
    assert has("relationship of plc-1 and press-1 ended") == 1
    assert has("relationship of plc-1 and press-1 parameterised again: cyclic data is not valid") == 1
    assert has("provider stop") == 1
    assert has("no frame of the PLC for", "lost after 12 ms") == 1
    assert has("axis 1", "PLC lost: the gateway stops the drive") == 4, (
        "in STOP, in silence, after Release and PrmBegin"
    )
    assert has("axis 1", "diagnosis, slot 1.1, Communication error to the higher-level control system appears") == 2
    assert has("axis 2", "diagnosis, slot 2.1, Communication error to the higher-level control system appears") == 2
    assert has("STW1", "047Eh -> 047Fh", "-> executed") == 5
    assert has("STW1", "047Eh -> 047Fh", "then: PLC lost") == 1, "the release comes right behind the last ON before it"
