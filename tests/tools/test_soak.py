"""Random lives in virtual time: a short campaign, and that each invariant is held against gateways that break it."""

from __future__ import annotations

import gc
import re
import weakref
from typing import Any

import pytest
from typer import Typer
from typer.testing import CliRunner

from pdgw.ds301.client import NodeClient
from pdgw.durations import SECOND
from pdgw.gateway.axis import interlock
from pdgw.gateway.axis.interlock import Interlock
from pdgw.gateway.axis.power_table import Phase
from pdgw.gateway.axis.settings import PlcLossReaction
from pdgw.gateway.axis.waist import PowerWish
from pdgw.gateway.transport.cyclic import CyclicEndpoint
from pdgw.tools.commands.soak import soak
from pdgw.tools.soak.life import PART_NS, Life
from pdgw.tools.soak.troubles import TROUBLES
from pdgw.tools.soak.watch import SoakAxis, ViolationError
from pdgw.tools.soak.words import Words

APP = Typer()
APP.command()(soak)


@pytest.mark.parametrize("numbers", [(1,), (9,), (100,), (1, 9), (3, 20), (5, 111)], ids=str)
@pytest.mark.parametrize("seed", range(2))
def test_nothing_that_must_not_happen_happens(seed: int, numbers: tuple[int, ...]) -> None:
    life = Life(seed, 0, numbers)
    life.play(60 * SECOND)
    assert life.starts >= 2 * len(numbers), "a life without starts proves nothing"


def test_one_seed_is_one_life_and_another_is_another() -> None:
    def lived(seed: int) -> tuple[list[str], int, dict[str, int]]:
        life = Life(seed, 0, [1], frames=True)
        life.play(30 * SECOND)
        return life.trace.lines, life.bus.frames, dict(life.plc.endpoint.counters)

    assert lived(3) == lived(3)
    assert lived(3) != lived(4)


def test_a_part_of_the_day_is_reached_without_those_before_it() -> None:
    life = Life(1, 2, [1])
    life.play(2 * PART_NS + 10 * SECOND)
    assert life.loop.now() == 2 * PART_NS + 10 * SECOND
    assert life.trace.lines[0].startswith("00:20:0")


def test_every_trouble_comes_and_ends() -> None:
    life = Life(11, 0, [1])
    seen: set[str] = set()
    note = life.trace.note

    def listen(text: str) -> None:
        seen.update(trouble.name for trouble in TROUBLES if f"{trouble.name} for" in text)
        note(text)

    life.trace.note = listen  # type: ignore[method-assign]
    every = {trouble.name for trouble in TROUBLES}
    for minutes in range(1, 11):
        life.play(minutes * 60 * SECOND)
        if seen == every:
            break
    assert seen == every


# -- gateways that would fail -----------------------------------------------------------------------------------------------


def violation(numbers: tuple[int, ...] = (1,)) -> str:
    life = Life(1, 0, numbers)
    with pytest.raises(ViolationError) as caught:
        life.play(300 * SECOND)
    return str(caught.value)


@pytest.mark.planted
def test_a_gateway_that_forgets_the_loss_of_its_plc_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(CyclicEndpoint, "lose_setpoints", lambda self: None)
    assert "started without OFF after a doubt (provider STOP" in violation()


@pytest.mark.planted
def test_a_gateway_that_obeys_without_off_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    step = Interlock.step

    def forgetful(self: Interlock, *arguments: Any, **named: Any) -> int:
        if self.phase is Phase.LOCKED:
            self.phase = Phase.FOLLOW
        return step(self, *arguments, **named)

    monkeypatch.setattr(Interlock, "step", forgetful)
    assert "started without OFF after a doubt" in violation()


@pytest.mark.planted
def test_a_gateway_that_lets_a_drive_turn_without_a_plc_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SoakAxis, "doubt", lambda self, *_: None)  # it would be found by its start first
    monkeypatch.setattr(interlock, "_NO_PLC", dict.fromkeys(PlcLossReaction, PowerWish.ENABLE))
    assert re.search(r"turns with .* rpm under power 10\d\d ms after a loss", violation())


@pytest.mark.planted
def test_a_task_that_the_plc_did_not_give_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Words, "set_word", lambda self, word: self.values.update({self.name: word}))
    assert re.search("tasks begun, 0 given by the PLC", violation((9,)))


def test_a_zsw1_that_shows_what_is_not_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Life, "_shown", lambda self, axis: 0x0007)
    assert re.search("ZSW1 0007h shows (operation|no fault), the drive is in", violation())


@pytest.mark.planted
def test_a_gateway_that_never_finds_its_drive_again_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    bring_up = NodeClient._bring_up

    def once(self: NodeClient) -> None:  # type: ignore[type-arg]
        if self.generation:
            self.loop.sleep(3600 * SECOND)
        bring_up(self)

    monkeypatch.setattr(NodeClient, "_bring_up", once)
    assert re.search("not in operation 20 s after the last trouble: axis 1", violation())


# -- the command ------------------------------------------------------------------------------------------------------------


def test_the_command_says_what_was_played() -> None:
    result = CliRunner().invoke(APP, ["--hours", "0.005", "--seed", "4", "--axes", "2", "--telegrams", "1,9"])
    assert result.exit_code == 0, result.output
    assert "00:00:18.000000 h of seed 4" in result.output
    assert "nothing that must not happen" in result.output


@pytest.mark.planted
def test_a_failure_is_told_with_the_command_that_shows_its_moment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(CyclicEndpoint, "lose_setpoints", lambda self: None)
    failed = CliRunner().invoke(APP, ["--hours", "0.2", "--seed", "25"])
    assert failed.exit_code == 1
    again = re.search(r"pdgw soak (--seed 25 --axes 1 --telegrams 1 --until ([\d.]+) --trace)", failed.output)
    assert again, failed.output
    shown = CliRunner().invoke(APP, again[1].split())
    assert shown.exit_code == 1
    assert "CAN gateway: 77Fh 05" in shown.output
    told = re.findall(r"^\d\d:\d\d:\d\d\.\d{6} axis 1: .*", failed.output, re.MULTILINE)
    assert told
    assert told[-1] in shown.output


def test_wrong_telegrams_are_told() -> None:
    result = CliRunner().invoke(APP, ["--telegrams", "1,x"])
    assert "expected numbers with commas between" in str(result.exception)


def test_nothing_of_a_part_is_left_after_it() -> None:
    """A day is many parts: what one keeps is a leak."""
    life = Life(1, 0, [1])
    life.play(5 * SECOND, lambda _: None)
    world = weakref.ref(life.world)
    life.close()
    del life
    gc.collect()
    assert world() is None
