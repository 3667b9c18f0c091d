"""The PLC simulator's words for positioners: which bits they are, against the real positioner's rules."""

from __future__ import annotations

from typing import Any

import pytest

from pdgw.gateway.errors import GatewayError
from pdgw.peers.plc.engine import Engine
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.peers.plc.scenario import Scenario
from pdgw.profidrive.telegrams import telegram

CYCLE = 4_000_000
ACKNOWLEDGED, HOME_SET = 0x1000, 0x0800


class Desk:
    """One axis whose ZSW1 the test answers; every STW1 that was sent."""

    def __init__(self, number: int, *steps: dict[str, Any]) -> None:
        self.endpoint = PlcEndpoint([telegram(number)], CYCLE)
        self.engine = Engine(Scenario.model_validate({"telegrams": [number], "steps": list(steps)}), self.endpoint)
        self.now = 0
        self.sent: list[int] = []
        self.answer(0)

    def answer(self, zsw1: int) -> None:
        names = self.endpoint.telegrams[0].actuals.names
        self.endpoint.actuals[0] = {**dict.fromkeys(names, 0), "ZSW1": zsw1}

    def cycles(self, count: int = 1) -> dict[str, int]:
        for _ in range(count):
            self.engine.step(self.now)
            self.now += CYCLE
            word = self.endpoint.setpoints[0]["STW1"]
            if self.sent[-1:] != [word]:
                self.sent.append(word)
        return self.endpoint.setpoints[0]

    def play(self) -> None:
        """Acknowledge as a positioner does."""
        for _ in range(200):
            word = self.cycles()["STW1"]
            self.answer(ACKNOWLEDGED if word & 0x40 else HOME_SET)
            if self.engine.finished:
                return
        raise AssertionError("not finished")


def test_an_absolute_task_of_111_is_the_worked_example() -> None:
    desk = Desk(111, {"mdi": {"to": 50_000, "velocity": 12_000}})
    assert desk.cycles() | {"STW1": 0x047F} == telegram(111).setpoints.as_dict(
        telegram(111).setpoints.decode(
            bytes.fromhex("047F 8100 0000 0000 4000 0000 C350 0000 2EE0 4000 4000 0000".replace(" ", ""))
        )
    )
    assert desk.endpoint.setpoints[0]["STW1"] & 0x70 == 0x70
    desk.play()
    assert desk.engine.passed
    assert not desk.endpoint.setpoints[0]["STW1"] & 0x40


def test_continuous_update_keeps_the_edge_bit() -> None:
    desk = Desk(111, {"mdi": {"to": 5, "update": True}}, {"mdi": {"to": 9, "update": True}})
    desk.play()
    assert desk.endpoint.setpoints[0]["STW1"] & 0x40
    assert (desk.endpoint.setpoints[0]["MDI_TARPOS"], desk.endpoint.setpoints[0]["POS_STW1"]) == (9, 0x9100)
    assert desk.sent == [0x70]


@pytest.mark.parametrize(("velocity", "word"), [(3000, 0xC200), (-3000, 0xC400)])
def test_setting_up_has_one_direction(velocity: int, word: int) -> None:
    desk = Desk(111, {"setting_up": {"velocity": velocity}})
    values = desk.cycles()
    assert (values["POS_STW1"], values["MDI_VELOCITY"]) == (word, 3000)


@pytest.mark.parametrize(("number", "name"), [(7, "SATZANW"), (110, "SATZANW"), (111, "POS_STW1")])
def test_a_block_is_selected_without_mdi(number: int, name: str) -> None:
    desk = Desk(number, {"block": 5})
    assert desk.cycles()[name] == 5


def test_jog_and_incremental_jog() -> None:
    desk = Desk(111, {"jog": 1}, {"hold": "20 ms"}, {"jog_distance": 2}, {"hold": "20 ms"}, {"jog": 0})
    assert (desk.cycles()["STW1"], desk.cycles()["POS_STW2"]) == (0x0130, 0)
    values = desk.cycles(6)
    assert (values["STW1"], values["POS_STW2"]) == (0x0230, 0x0020)
    values = desk.cycles(10)
    assert (values["STW1"], values["POS_STW2"]) == (0x0030, 0)


def test_bits_with_a_counting_edge_stay_set_for_many_cycles() -> None:
    desk = Desk(111, {"next_block": True})
    assert desk.cycles(20)["STW1"] & 0x2000
    assert not desk.cycles(10)["STW1"] & 0x2000
    desk = Desk(110, {"set_reference": True})
    assert desk.cycles(20)["POS_STW"] == 2
    desk.answer(HOME_SET)
    assert desk.cycles(20)["POS_STW"] == 0


@pytest.mark.parametrize(
    ("number", "step", "message"),
    [
        (9, {"mdi": {"to": 1}}, "not possible with telegram 9, only with 7, 110, 111"),
        (7, {"mdi": {"to": 1}}, "not possible with telegram 7: it has no MDI_TARPOS or MDI_TARPOS_F"),
        (110, {"mdi": {"to": 1, "update": True}}, "update is not possible with telegram 110"),
        (110, {"setting_up": {"velocity": 1}}, "not possible with telegram 110: it has no POS_STW1"),
        (7, {"set_reference": True}, "not possible with telegram 7: it has no POS_STW2 or POS_STW"),
        (111, {"block": 128}, "POS_STW1.BLOCK = 128: expected 0..127"),
        (7, {"block": 64}, "SATZANW.BLOCK = 64: expected 0..63"),
    ],
)
def test_unsupported_action_of_a_telegram_is_reported(number: int, step: dict[str, Any], message: str) -> None:
    with pytest.raises(GatewayError, match=message):
        Desk(number, step)
