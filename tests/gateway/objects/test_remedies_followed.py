"""Each remedy, followed literally by a program: the reason is gone or a later one is named, and no shaft moves unasked.

The steps of a person are marked by their type and counted: the cause that they remove is removed for them.
"""

from __future__ import annotations

import random
from collections import Counter

import pytest

from pdgw.base.durations import SECOND
from pdgw.gateway.axis.telegrams import DRIVE_TELEGRAM_NUMBERS, ENCODER_TELEGRAM_NUMBERS
from pdgw.gateway.base.reasons import AxisState, Reason
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.objects.axis import Axis
from tests.support.documents.plc_situations import CONTROLLER_SITUATIONS
from tests.support.documents.situation_table import BY_LINK
from tests.support.documents.situations import SITUATIONS, SLOW_PLC, at_situation, run_out
from tests.support.gateways.daemon import Plc, configuration, drive_of, encoder_of, running, world_of
from tests.support.gateways.remedy_follower import Follower, table

_EPISODES = 12
_ROUNDS = 8
"""Remedies one after the other until the axis follows the PLC."""
_PRESSED = {"STW1": 0x0FFF, "Controlword": 0x8F, "POS_STW1": 0xD77F, "POS_STW2": 0xC023, "SATZANW": 0x8007}
_PRESSED |= {"POS_STW": 0x23, "MDI_MOD": 7, "STW2_ENC": 0x480, "G1_STW": 0xC011}
"""Bits that a program may set and clear."""
_OFTEN = 0x0B70
"""STW1.4 to .6, jogs and homing."""
_VALUES = ("MDI_VELOCITY", "MDI_ACC", "MDI_DEC", "OVERRIDE", "MDI_VELOCITY_F", "MDI_DEC_F")
_OFF = (Reason.SWITCHED_OFF,)
FOLLOWED: Counter[tuple[int, Reason]] = Counter()


def test_the_steps_of_a_person_are_marked() -> None:
    """All remedies of the table: those of a program, of both, of a person."""
    kinds: Counter[str] = Counter()
    for reason in Reason:
        persons = [isinstance(step, str) for step in reason.remedy]
        kinds["person" if all(persons) else "both" if any(persons) else "program"] += 1
    assert kinds == {"program": 41, "both": 21, "person": 35}


def press(rng: random.Random, follower: Follower) -> None:
    """One thing that a program does."""
    words = follower.words
    kind = rng.random()
    values = [name for name in _VALUES if name in words]
    if kind < 0.1:
        follower.fail()
    elif kind < 0.25 and values:
        follower.exchange(1, **{rng.choice(values): 0})
    elif kind < 0.3 and "MDI_TARPOS" in words:
        follower.exchange(1, MDI_TARPOS=2_000_000_000)
    elif kind < 0.45 and "NSOLL_A" in words:
        follower.exchange(1, STW1=words["STW1"] & ~0x370 | rng.choice((0x100, 0x200, 0x300)))
    else:
        name = rng.choice([name for name in words if name in _PRESSED] + [follower.first])
        weights = [(1 + 3 * (_OFTEN >> bit & 1)) * (_PRESSED[name] >> bit & 1) for bit in range(16)]
        follower.exchange(1, **{name: words[name] ^ 1 << rng.choices(range(16), weights)[0]})
    follower.exchange(rng.choice((0, 0, 3, 30)))


def follow_all(follower: Follower) -> str:
    """Follow the remedies until the axis follows the PLC, or a person is needed; returns why not."""
    seen = []
    for _ in range(_ROUNDS):
        link = follower.broken
        if link is None or link.reason in _OFF:
            return ""
        assert link.reason is not None
        sentence = link.reason, link.todo
        if sentence in seen:
            return f"{link.evidence} -> {link.todo}: after {[text for _, text in seen]}"
        seen.append(sentence)
        left = follower.follow(link.found.remedy)
        FOLLOWED[len(left), link.reason] += 1
    return f"{seen}"


@pytest.mark.parametrize("number", [*DRIVE_TELEGRAM_NUMBERS, *ENCODER_TELEGRAM_NUMBERS])
def test_remedies_after_random_presses(number: int) -> None:
    rng = random.Random(number)
    with running(configuration(table(number), transport=SLOW_PLC)) as daemon:
        follower = Follower(Plc(daemon, [number]))
        for episode in range(_EPISODES):
            follower.begin()
            for _ in range(rng.randint(1, 4)):
                press(rng, follower)
            follower.exchange(40)
            words = {name: f"{value:X}" for name, value in follower.words.items()}
            why = follow_all(follower)
            assert why == "", f"episode {episode}: {words}: {why}"
            assert follower.item.enable_status.state in (AxisState.OBEYS, AxisState.OFF)


def repair(plc: Plc, daemon: Daemon) -> None:
    """What a person does: devices, cables and the PLC are as they should be."""
    plc.change, plc.silent, plc.endpoint.run = bytes, False, True
    plc.endpoint.bad.clear()
    world_of(daemon).unplug("world", False)
    for item in daemon.objects:
        if isinstance(item, Axis):
            drive = drive_of(daemon, item.node_id)
            drive.node.end_fault()
            drive.clear()
            drive.model.disguises.clear()
            drive.model._update()
        else:
            encoder = encoder_of(daemon, item.node_id)
            encoder.node.end_fault()
            encoder.clear()
        if not item.good:
            world_of(daemon).simulations["can"].device(item.node_id).node.restart()
    run_out(plc, 4 * SECOND)


_SAMPLE = {title: item for title, item in SITUATIONS.items() if "PLC" in title} | CONTROLLER_SITUATIONS


@pytest.mark.parametrize(
    ("link", "title"), [("udp", title) for title in BY_LINK["udp"]] + [("profinet", title) for title in _SAMPLE]
)
def test_remedy_of_a_situation(link: str, title: str) -> None:
    situation = BY_LINK[link][title]
    with at_situation(situation, link) as (daemon, plc):
        follower = Follower(plc)
        broken = follower.broken
        assert broken is not None
        person = any(isinstance(step, str) for step in broken.found.remedy)
        if person:
            repair(plc, daemon)
        why = follow_all(follower)
        if why and person:
            situation.cure(plc, daemon)  # what this person has to do is not a repair
            run_out(plc)
            why = follow_all(follower)
        assert not why, why
