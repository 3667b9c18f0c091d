"""Timeline and replay of captures with two redundant controllers: what the PLC orders comes from the one that leads."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from pdgw.decoder.timeline.text import entry_lines
from pdgw.durations import MS
from pdgw.gateway.reasons import Reason
from pdgw.recording.recordings import followed, known_from, load, look_ahead
from tests.support.gateways.profinet_daemon import OFF, ON
from tests.support.gateways.twin_controllers import (
    HOLD_MS,
    OTHER_SPEED,
    SPEED,
    WAYS,
    Twins,
    die,
    hand_over,
    release,
    twins,
)

_LOST = Reason.PLC_LOST.value


def lines(pair: Twins, folder: Path) -> list[str]:
    opening = look_ahead(pair.site.write(folder), known_from(None, [], []), 0, lambda _: None)
    return ["".join(entry_lines(entry, opening.begin_ns)) for entry in followed(opening)]


def count(found: list[str], *parts: str) -> int:
    return sum(all(part in line for part in parts) for line in found)


def differences(pair: Twins, folder: Path) -> list[str]:
    """What the replay finds; none without having compared much."""
    loaded = load(pair.site.write(folder), known_from(None, [], []), 0, lambda _: None)
    (outcome,) = loaded.replay(first_only=True)
    assert outcome.differences or outcome.compared > 100
    return [f"{item.what} {item.names}" for item in outcome.differences]


@pytest.mark.parametrize("way", WAYS, ids=lambda way: way.__name__)
def test_after_a_switchover_the_frames_of_the_new_leader_count(tmp_path: Path, way: Callable[[Twins], None]) -> None:
    with twins(tmp_path) as pair:
        way(pair)
        pair.site.run(50 * MS)
        pair.other.lead(primary=True)
        pair.site.run(300 * MS)
        pair.set(pair.other, ON, OTHER_SPEED)
        pair.site.run(300 * MS)
        pair.set(pair.other, OFF, OTHER_SPEED)
        pair.site.run(500 * MS)
        found = lines(pair, tmp_path)
        assert differences(pair, tmp_path) == []
    assert count(found, "controller plc-1 leads") == count(found, "controller plc-2 leads") == 1
    assert count(found, _LOST) == count(found, "no frame of the PLC") == count(found, "missing") == 0
    assert count(found, "not primary") == (way is hand_over), "plc-1 stopped leading"
    assert count(found, "STW1", "047Fh -> 047Eh", Reason.RAMP_STOP.value) == 1


def test_a_switchover_too_late_is_a_loss_of_the_plc(tmp_path: Path) -> None:
    with twins(tmp_path) as pair:
        release(pair)
        pair.site.run((HOLD_MS + 100) * MS)
        found = lines(pair, tmp_path)
        assert differences(pair, tmp_path) == []
    assert count(found, _LOST) == 1
    assert count(found, "controller plc-2 leads") == 0


def test_lost_backup_does_not_keep_the_connection(tmp_path: Path) -> None:
    with twins(tmp_path, data_hold=10) as pair:
        pair.site.dead.add(pair.other)
        pair.site.run(60 * MS)
        die(pair)
        pair.site.run(300 * MS)
        found = lines(pair, tmp_path)
        assert differences(pair, tmp_path) == []
    assert count(found, _LOST) == 1
    assert count(found, "no frame of the PLC", "lost after 12 ms") == 1


def test_another_order_of_the_new_leader_is_a_loss_for_the_axis(tmp_path: Path) -> None:
    with twins(tmp_path) as pair:
        pair.set(pair.other, ON | 0x800, SPEED)
        pair.other.lead(primary=True)
        hand_over(pair)
        pair.site.run(500 * MS)
        found = lines(pair, tmp_path)
        assert differences(pair, tmp_path) == []
    assert count(found, "controller plc-2 leads") == 1
    assert count(found, _LOST) == 1
