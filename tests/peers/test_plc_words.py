"""Every function of the PLC simulator by name: words and their bits, and actions run on a gateway in virtual time."""

from __future__ import annotations

import re
import struct
from typing import Any

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.gateway.base.errors import GatewayError
from pdgw.peers.plc.engine import Engine
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.peers.plc.exchange.following import Follow, Following, PositionLoop
from pdgw.peers.plc.keyboard import Keyboard
from pdgw.peers.plc.notation import words_of
from pdgw.peers.plc.scenario import Scenario
from pdgw.peers.plc.scenario_file import parse_step, scenario_of
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import TELEGRAMS, ApplicationMode, telegram
from tests.conformance.telegram_bits import gateway

CYCLE = 4_000_000
FLOATS = ("mdi_tarpos_f", "mdi_velocity_f", "mdi_acc_f", "mdi_dec_f", "ref_coordinate")
"""Setpoints of telegram 112 that are IEEE 754 numbers."""
ON = ({"expect": {"ZSW1.CONTROL_REQUESTED": 1}, "within": "20 s"}, {"enable": True})


def run_plc(number: int, *steps: dict[str, Any]) -> PlcEndpoint:
    """Steps without a gateway."""
    endpoint = PlcEndpoint([telegram(number)], CYCLE)
    engine = Engine(scenario_of([telegram(number)], steps), endpoint)
    for cycle in range(100):
        engine.step(cycle * CYCLE)
    assert engine.finished
    return endpoint


def on_a_gateway(number: int, *steps: dict[str, Any]) -> None:
    """Steps with a gateway and its drive, enabled; every expectation must hold."""
    with gateway(number) as plc:
        plc.run_steps((*ON, *steps))


@pytest.mark.parametrize("number", TELEGRAMS)
def test_every_bit_a_telegram_sends_has_a_word_of_its_own(number: int) -> None:
    half = telegram(number).setpoints
    bits = [
        (item.name, bit.name)
        for item in half.signals
        for bit in item.fields(positioning=half.mode is ApplicationMode.POSITIONING)
        if not bit.name.startswith(("DEVICE_", "RESERVED"))
    ]
    words = words_of(telegram(number).setpoints).values()
    assert [(word.signal.name, word.bit.name) for word in words if word.bit is not None] == bits
    assert [word.signal.name for word in words if word.bit is None] == list(half.names)


@pytest.mark.parametrize("number", TELEGRAMS)
def test_every_word_of_a_telegram_sets_what_it_names(number: int) -> None:
    for word in words_of(telegram(number).setpoints).values():
        values = run_plc(number, {"set": {word.name: 1}}).setpoints[0]
        one = struct.unpack(">I", struct.pack(">f", 1.0))[0] if word.name in FLOATS else 1
        assert values == {**dict.fromkeys(values, 0), word.signal.name: one << (word.bit.position if word.bit else 0)}


def test_words_of_one_step_go_out_in_one_frame() -> None:
    endpoint = run_plc(111, {"tracking": True, "override": "50 %", "axis": 1, "note": "both"})
    assert (endpoint.setpoints[0]["POS_STW2"], endpoint.setpoints[0]["OVERRIDE"]) == (1, 0x2000)


def test_yaml_key_on_is_the_bit_on() -> None:
    assert run_plc(1, {True: 1}).setpoints[0]["STW1"] == signal("STW1").word("ON")  # type: ignore[dict-item]


@pytest.mark.parametrize(
    ("number", "step", "text"),
    [
        (111, {"trackin": 1}, "trackin: unknown word; did you mean tracking?"),
        (111, {"jogg": 1}, "jogg: unknown word; did you mean jog?"),
        (1, {"tracking": 1}, "tracking: not in telegram 1, only in 110, 111"),
        (1, {"set": {"NSOL_A": 1}}, r"signal 'NSOL_A' is not in the telegram; did you mean NSOLL_A\? \(allowed: STW1, NSOLL_A\)"),
        (1, {"expect": {"ZSW1.FAULTY": 1}}, r"ZSW1.FAULTY: not a bit of ZSW1; did you mean FAULT\?"),
        (111, {"block": 3, "tracking": 1}, "2 actions"),
        (111, {"data_set": 32}, r"data_set = 32: expected 0\.\.31"),
        (9, {"homing_method": -129}, r"homing_method = -129: expected -128\.\.255"),
        (9, {"jog": 1}, "not possible with telegram 9, only with 1, 2, 3, 4, 7, 20, 102, 103, 110, 111"),
        (105, {"jog": 1}, "not possible with telegram 105"),
        (9, {"home": {"passive": True}}, "passive and negative are not possible with telegram 9: it has no POS_STW2"),
        (110, {"home": {"passive": True}}, "passive and negative are not possible with telegram 110"),
        (111, {"home": {"method": 35}}, "home.method is allowed only with telegram 9"),
        (1, {"reference_mark": 1}, "not possible with telegram 1: it has no G1_STW"),
        (102, {"measure": {"sensor": 2}}, "not possible with telegram 102: it has no G2_STW"),
        (102, {"follow": {"by": 4096, "error": 10}}, "not possible with telegram 102, only with 5, 6, 105, 106"),
        (1, {"sign_of_life": True}, "not possible with telegram 1: it has no sign of life"),
        (111, {"mdi": {"to": 1.5}}, r"MDI_TARPOS = '1\.5': expected"),
        (112, {"mdi": {"to": 1.5}}, "mdi.velocity is missing: telegram 112 needs it"),
        (112, {"expect": {"XIST_F": "& 64 = 64"}}, "XIST_F = & 64 = 64: & is allowed only for words of bits"),
        (111, {"speed": "5 %"}, "not possible with telegram 111: it has no speed setpoint"),
    ],
)  # fmt: skip
def test_word_that_does_not_fit_is_reported(number: int, step: dict[str, Any], text: str) -> None:
    with pytest.raises(GatewayError, match=text):
        run_plc(number, step)


def test_a_typed_line_is_a_step() -> None:
    assert parse_step("mdi {to: 5, update: true}") == {"mdi": {"to": 5, "update": True}}
    assert parse_step("override: 50 %") == {"override": "50 %"}
    assert parse_step(" reject ") == {"reject": True}


def test_override_stays_for_the_next_task() -> None:
    endpoint = PlcEndpoint([telegram(111)], CYCLE)
    engine = Engine(scenario_of([telegram(111)], [{"override": "25 %"}, {"mdi": {"to": 5}}]), endpoint)
    engine.step(0)
    assert endpoint.setpoints[0]["OVERRIDE"] == 0x1000


def test_the_sign_of_life_counts_from_1_to_15_with_each_frame() -> None:
    endpoint = run_plc(2, {"sign_of_life": True})
    life = signal("STW2").bit("SIGN_OF_LIFE")
    seen = []
    for _ in range(17):
        endpoint.build()
        seen.append(life.of(endpoint.setpoints[0]["STW2"]))
    assert seen == [*range(1, 16), 1, 2]
    Engine(scenario_of([telegram(2)], [{"sign_of_life": False}]), endpoint).step(0)
    endpoint.build()
    assert life.of(endpoint.setpoints[0]["STW2"]) == 2


@pytest.mark.parametrize("number", [1, 2, 3, 4, 20, 102, 103])
def test_jog_turns_an_axis_with_a_speed_telegram_and_leaves_speed_0(number: int) -> None:
    actual = next(name for name in telegram(number).actuals.names if name.startswith("NIST"))
    turns, stands = {"expect": {actual: "< -1 %"}}, {"expect": {actual: 0}}
    on_a_gateway(number, {"speed": "10 %"}, {"speed": 0}, stands, {"jog": 1}, turns, {"jog": 0}, stands)


def test_tracking_fixed_stop_and_limits_are_seen_by_the_positioner() -> None:
    on_a_gateway(
        111,
        {"tracking": 1},
        {"expect": {"POS_ZSW2.TRACKING": 1}},
        {"tracking": 0},
        {"home": {"passive": True}},
        {"expect": {"POS_ZSW1.PASSIVE_HOMING": 1}},
        {"stop_homing": True},
        {"expect": {"POS_ZSW1.PASSIVE_HOMING": 0}},
        {"set_reference": True},
        {"software_limits": 1},
        {"mdi": {"to": 2_000_000, "velocity": 30_000, "acceleration": "50 %"}},
        {"expect": {"ZSW1.WARNING": 1}},
        {"reject": True},
    )


def test_tasks_of_telegram_112_are_in_its_unit_of_length() -> None:
    on_a_gateway(
        112,
        {"mdi": {"to": 12.5, "velocity": 3000.5, "acceleration": "50 %"}},
        {"expect": {"ZSW1.TARGET_REACHED": 1, "XIST_F": "12.5 +- 0.01"}, "within": "10 s"},
        {"mdi": {"to": -10, "velocity": 3000, "relative": True}},
        {"expect": {"ZSW1.TARGET_REACHED": 1, "XIST_F": "2.5 +- 0.01"}, "within": "10 s"},
        {"setting_up": {"velocity": -600.5}},
        {"expect": {"VIST_F": "-600.5 +- 1", "XIST_F": "< -1"}, "within": "10 s"},
        {"reject": True},
    )


def test_no_key_moves_by_length_units_with_telegram_112() -> None:
    def keys(number: int) -> set[str]:
        return set(Keyboard(PlcEndpoint([telegram(number)], CYCLE), print).keys_of(1))

    assert keys(111) - keys(112) == set("puUvV")


@pytest.mark.parametrize("wanted", ["12.5 +- 0.01", "> 0", 1, "< -0.5"])
def test_a_float_that_is_not_as_expected_fails(wanted: str | int) -> None:
    with pytest.raises(AssertionError, match=re.escape(f"XIST_F {wanted}: XIST_F = 0")):
        on_a_gateway(112, {"expect": {"XIST_F": wanted}, "within": "100 ms"})


def test_a_value_is_measured_on_the_fly_and_read() -> None:
    on_a_gateway(
        102,
        {"speed": "10 %"},
        {"measure": {"function": 1}},
        {"expect": {"G1_ZSW.FUNCTION_1": 1}},
        {"drive": "probe 1 on"},
        {"read_value": {"function": 1}},
        {"expect": {"G1_XIST2": "> 0", "G1_ZSW.ERROR": 0}},
        {"reference_mark": 1},
        {"read_value": {"function": 1}, "within": "5 s"},
        {"stop_measuring": 1},
        {"expect": {"G1_ZSW.FUNCTION_1": 0, "G1_ZSW.ERROR": 0}},
    )


@pytest.mark.parametrize(
    ("number", "wish"),
    [
        (105, {"error": 120}),
        (105, {"error": 120, "feed_forward": True, "gain": 10}),
        (105, {"error": 800, "dsc": False, "gain": 10}),
        (102, {"error": 800, "dsc": False, "gain": 10}),
    ],
)
def test_an_axis_follows_a_sine(number: int, wish: dict[str, Any]) -> None:
    on_a_gateway(
        number,
        {"follow": {"by": 4096, **wish}, "within": "20 s"},
        {"expect": {"NIST_B": "0 +- 2 %"}},
    )


def test_follow_restarts_at_the_position_of_a_stopped_axis() -> None:
    """The axis was stopped far away, for example by DSC without new frames: its next period begins at its position."""
    following = Following(Follow(by=4096, error=400), 60 * SECOND, increments=4096, rpm=3000, dsc=True)
    errors = []
    for cycle in range(1001):
        wanted = following.step(cycle * 4 * MS, {"G1_XIST1": 30_000 if cycle else 0})
        assert wanted is not None
        errors.append(wanted["XERR"])
    assert max(map(abs, errors[:500])) > 25_000
    assert errors[501] == 0
    assert max(map(abs, errors[501:])) <= 4096


def test_an_axis_that_does_not_follow_closely_enough_fails_with_its_error() -> None:
    with pytest.raises(AssertionError, match=r"follows a sine of 4096 increments at 0\.5 Hz within 1.*largest error"):
        on_a_gateway(105, {"follow": {"by": 4096, "error": 1}, "within": "5 s"})


@pytest.mark.parametrize("step", [{"momred": "50 %"}, {"park_axis": 1}, {"g1_park": 1}, {"g1_error_acknowledge": 1}])
def test_words_of_a_speed_telegram_are_taken_while_it_runs(step: dict[str, Any]) -> None:
    on_a_gateway(103, step, {"hold": "50 ms"}, {"expect": {"ZSW1.OPERATION_ENABLED": 1}})


ACKNOWLEDGED, HOME_SET = 0x1000, 0x0800


class PositionerDesk:
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

    def run_plc(self) -> None:
        """Acknowledge as a positioner does."""
        for _ in range(200):
            word = self.cycles()["STW1"]
            self.answer(ACKNOWLEDGED if word & 0x40 else HOME_SET)
            if self.engine.finished:
                return
        raise AssertionError("not finished")


def test_an_absolute_task_of_111_is_the_worked_example() -> None:
    desk = PositionerDesk(111, {"mdi": {"to": 50_000, "velocity": 12_000}})
    assert desk.cycles() | {"STW1": 0x047F} == telegram(111).setpoints.as_dict(
        telegram(111).setpoints.decode(
            bytes.fromhex("047F 8100 0000 0000 4000 0000 C350 0000 2EE0 4000 4000 0000".replace(" ", ""))
        )
    )
    assert desk.endpoint.setpoints[0]["STW1"] & 0x70 == 0x70
    desk.run_plc()
    assert desk.engine.passed
    assert not desk.endpoint.setpoints[0]["STW1"] & 0x40


def test_continuous_update_keeps_the_edge_bit() -> None:
    desk = PositionerDesk(111, {"mdi": {"to": 5, "update": True}}, {"mdi": {"to": 9, "update": True}})
    desk.run_plc()
    assert desk.endpoint.setpoints[0]["STW1"] & 0x40
    assert (desk.endpoint.setpoints[0]["MDI_TARPOS"], desk.endpoint.setpoints[0]["POS_STW1"]) == (9, 0x9100)
    assert desk.sent == [0x70]


@pytest.mark.parametrize(("velocity", "word"), [(3000, 0xC200), (-3000, 0xC400)])
def test_setting_up_has_one_direction(velocity: int, word: int) -> None:
    desk = PositionerDesk(111, {"setting_up": {"velocity": velocity}})
    values = desk.cycles()
    assert (values["POS_STW1"], values["MDI_VELOCITY"]) == (word, 3000)


@pytest.mark.parametrize(("number", "name"), [(7, "SATZANW"), (110, "SATZANW"), (111, "POS_STW1")])
def test_a_block_is_selected_without_mdi(number: int, name: str) -> None:
    desk = PositionerDesk(number, {"block": 5})
    assert desk.cycles()[name] == 5


def test_jog_and_incremental_jog() -> None:
    desk = PositionerDesk(111, {"jog": 1}, {"hold": "20 ms"}, {"jog_distance": 2}, {"hold": "20 ms"}, {"jog": 0})
    assert (desk.cycles()["STW1"], desk.cycles()["POS_STW2"]) == (0x0130, 0)
    values = desk.cycles(6)
    assert (values["STW1"], values["POS_STW2"]) == (0x0230, 0x0020)
    values = desk.cycles(10)
    assert (values["STW1"], values["POS_STW2"]) == (0x0030, 0)


def test_bits_with_a_counting_edge_stay_set_for_many_cycles() -> None:
    desk = PositionerDesk(111, {"next_block": True})
    assert desk.cycles(20)["STW1"] & 0x2000
    assert not desk.cycles(10)["STW1"] & 0x2000
    desk = PositionerDesk(110, {"set_reference": True})
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
        PositionerDesk(number, step)


def test_the_controller_sends_gain_and_error_with_dsc_and_their_product_without() -> None:
    actuals = {"G1_XIST1": 0xFFFF_FFFF}
    with_dsc = PositionLoop(50, dsc=True, increments_per_revolution=4096, reference_rpm=3000)
    assert with_dsc.step(2047, actuals) == {"NSOLL_B": 0, "XERR": 2048, "KPC": 50_000}
    without = PositionLoop(50, dsc=False, increments_per_revolution=4096, reference_rpm=3000)
    assert without.step(2047, actuals) == {"NSOLL_B": 0x2000_0000, "XERR": 0, "KPC": 0}, "25 rev/s"
