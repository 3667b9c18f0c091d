"""The PLC simulator's keys: a stop is never kept waiting, and nothing starts after it by itself."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.peers.plc.exchange.following import snapshot, tables
from pdgw.peers.plc.keyboard import Keyboard
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import telegram
from pdgw.tools.plc_window import Window

CYCLE = 4_000_000
READY, OPERATION = 0x31, 0x37


class Desk:
    """A keyboard on axes whose actual values the test sets; virtual time."""

    def __init__(self, *numbers: int) -> None:
        self.plc = PlcEndpoint([telegram(number) for number in numbers], CYCLE)
        self.reported: list[str] = []
        self.keyboard = Keyboard(self.plc, self.reported.append)
        self.now = 0
        self.answer(*[0] * len(numbers))

    def answer(self, *statuses: int) -> None:
        for axis, status in enumerate(statuses):
            names = self.plc.telegrams[axis].actuals.names
            self.plc.actuals[axis] = {**dict.fromkeys(names, 0), names[0]: status}

    def cycles(self, count: int = 1) -> None:
        for _ in range(count):
            self.keyboard.step(self.now)
            self.now += CYCLE

    def keys(self, keys: str) -> None:
        for key in keys:
            self.keyboard.press(key)
        self.cycles()

    def bit(self, name: str, axis: int = 0) -> int:
        item = signal("STW1").bit(name, positioning=self.plc.telegrams[axis].number == 9)
        return item.of(self.plc.setpoints[axis]["STW1"])


def test_enable_turns_and_off1() -> None:
    desk = Desk(1)
    desk.answer(READY)
    desk.keys("e")
    assert desk.bit("ON") == 1
    desk.answer(OPERATION)
    desk.cycles()
    desk.keys("++-")
    desk.cycles(3)
    assert desk.plc.setpoints[0]["NSOLL_A"] == 0x4000 // 10
    desk.keys("o")
    assert desk.bit("ON") == 0
    assert desk.reported == []


@pytest.mark.parametrize(("key", "name"), [("o", "ON"), ("q", "NO_QUICK_STOP"), ("c", "NO_COAST_STOP")])
def test_a_stop_acts_in_its_cycle_while_an_enable_waits_and_nothing_starts_later(key: str, name: str) -> None:
    desk = Desk(1)
    desk.keys("e")  # not ready: waits
    desk.keys(key)
    assert desk.bit(name) == 0
    desk.answer(READY)
    desk.cycles(3000)
    assert desk.bit("ON") == 0
    assert desk.bit(name) == 0


def test_enable_without_a_ready_drive_is_reported_and_sends_no_late_on() -> None:
    desk = Desk(1)
    desk.keys("e")
    desk.cycles(1000)
    assert desk.bit("ON") == 0
    assert len(desk.reported) == 1
    assert "ready" in desk.reported[0]
    desk.answer(READY)
    desk.keys("e")
    assert desk.bit("ON") == 1


def test_stop_clears_the_queue_and_completes_a_handshake() -> None:
    desk = Desk(9)
    acknowledge = signal("ZSW1").bit("TASK_ACKNOWLEDGE", positioning=True).mask
    desk.keys("mm")
    assert desk.bit("ACTIVATE_TASK") == 1
    desk.keys(" ")
    assert desk.bit("NO_INTERMEDIATE_STOP") == 0
    desk.answer(acknowledge)
    desk.cycles()
    assert desk.bit("ACTIVATE_TASK") == 0
    desk.answer(0)
    desk.cycles(2000)
    assert desk.bit("ACTIVATE_TASK") == 0  # the second task was dropped
    assert desk.bit("NO_INTERMEDIATE_STOP") == 0


def test_space_after_a_new_task_stops_again() -> None:
    desk = Desk(9)
    acknowledge = signal("ZSW1").bit("TASK_ACKNOWLEDGE", positioning=True).mask
    for _ in range(2):
        desk.keys("m")
        desk.answer(acknowledge)
        desk.cycles(2)
        desk.answer(0)
        desk.cycles(2)
        desk.keys(" ")
        assert desk.bit("NO_INTERMEDIATE_STOP") == 0
    desk.keys(" ")
    assert desk.bit("NO_INTERMEDIATE_STOP") == 1


def test_waiting_axis_does_not_delay_the_others() -> None:
    desk = Desk(1, 1)
    desk.answer(0, READY)
    desk.keys("e")
    assert (desk.bit("ON", 0), desk.bit("ON", 1)) == (0, 1)


def test_unsupported_keys_are_reported_and_unknown_ones_ignored() -> None:
    desk = Desk(1)
    before = dict(desk.plc.setpoints[0])
    desk.keys("mh %\n\x1b")
    desk.cycles(5)
    assert desk.plc.setpoints[0] == before
    assert len(desk.reported) == 3
    assert all("axis 1" in text for text in desk.reported)


def test_digits_choose_the_axis_the_keys_are_for() -> None:
    desk = Desk(1, 1)
    desk.answer(READY, READY)
    desk.keys("2e")
    assert (desk.bit("ON", 0), desk.bit("ON", 1)) == (0, 1)
    desk.keys("0e")
    assert (desk.bit("ON", 0), desk.bit("ON", 1)) == (1, 1)
    desk.answer(OPERATION, OPERATION)
    desk.cycles()
    desk.keys("1++")
    desk.keys("2-")
    desk.cycles(3)
    assert [item["NSOLL_A"] for item in desk.plc.setpoints] == [0x4000 // 5, -(0x4000 // 10)]
    desk.keys("9")
    assert desk.reported == ["axis 9: does not exist, the number of axes is 2"]


def test_only_keys_that_a_telegram_has_are_offered() -> None:
    desk = Desk(1, 9, 83)
    assert desk.keyboard.help.startswith("all axes:  o=OFF1")
    desk.keys("1")
    assert "faster" in desk.keyboard.help
    assert "move" not in desk.keyboard.help
    desk.keys("2")
    assert "faster" not in desk.keyboard.help
    assert "move" in desk.keyboard.help
    desk.keys("3")
    assert "absolute value" in desk.keyboard.help
    assert not {"faster", "move", "jog 1", "OFF1"} & set(desk.keyboard.help.replace("=", "  ").split("  "))


def test_a_key_for_all_axes_acts_on_those_that_have_it() -> None:
    desk = Desk(1, 9)
    desk.answer(OPERATION, OPERATION)
    desk.keys("m")
    assert desk.reported == []
    assert desk.bit("ACTIVATE_TASK", 1) == 1


def test_the_reason_of_an_axis_is_shown_above_its_words() -> None:
    plc = PlcEndpoint([telegram(1), telegram(1)], CYCLE)
    plc.actuals[1] = dict.fromkeys(plc.telegrams[1].actuals.names, 0)
    console = Console(width=100, record=True, file=io.StringIO())
    console.print(tables(snapshot(plc, "title"), ["", "ON ignored"]))
    lines = [line.strip() for line in console.export_text().splitlines()]
    assert any(line.startswith("axis 1: no datagram from a gateway: start one") for line in lines)
    assert "axis 2: ON ignored" in lines


def test_a_typed_word_is_a_step_of_a_scenario() -> None:
    desk = Desk(111)
    desk.keys(":override 25 x%")
    assert ":override 25 x%_" in desk.keyboard.help, "the exit key is a letter here"
    desk.keys("\x7f\x7f%\r")
    desk.cycles(2)
    assert desk.plc.setpoints[0]["OVERRIDE"] == 0x4000 // 4
    desk.keys(":tracking\n")
    desk.cycles(2)
    assert desk.plc.setpoints[0]["POS_STW2"] == 1
    desk.keys(":mdi {to: 700}\n:tracking 0")
    desk.keys("\x1b")
    desk.cycles(2)
    assert (desk.plc.setpoints[0]["MDI_TARPOS"], desk.plc.setpoints[0]["POS_STW2"]) == (700, 1)
    assert desk.reported == []


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("trackin 1", "trackin: unknown word; did you mean tracking?"),
        ("momred 50 %", "momred: not in telegram 111, only in 102, 103, 105, 106"),
        ("mdi {too: 4}", "mdi.too: unknown key; did you mean to?"),
        ("override 50 rpm rpm", "OVERRIDE = '50 rpm rpm': expected"),
        ("mdi {", "not valid YAML"),
        ("mute true", "mute: allowed only in a scenario"),
    ],
)
def test_unknown_typed_word_is_reported_with_a_suggestion(line: str, text: str) -> None:
    desk = Desk(111)
    before = dict(desk.plc.setpoints[0])
    desk.keys(f":{line}\n")
    desk.cycles(2)
    assert len(desk.reported) == 1
    assert text in desk.reported[0]
    assert "step 1" not in desk.reported[0]
    assert desk.plc.setpoints[0] == before


def test_a_typed_word_for_all_axes_is_for_those_that_have_it() -> None:
    desk = Desk(102, 111)
    desk.keys(":momred 50 %\n")
    desk.cycles(2)
    assert desk.plc.setpoints[0]["MOMRED"] == 0x2000
    assert desk.reported == []


def test_the_list_has_the_words_of_the_telegram() -> None:
    desk = Desk(105)
    desk.keys("?")
    (text,) = desk.reported
    assert text.startswith("telegram 105: enable, off1,")
    words = text.split(": ", 1)[1].split(", ")
    assert {"follow", "kpc", "xerr", "g1_park", "momred"} <= set(words)
    assert not {"mdi", "override", "jog", "read"} & set(words)
    assert len(words) == len(set(words))


def test_toggle_keys_switch_back_when_pressed_again() -> None:
    desk = Desk(105)
    desk.keys("dM")
    desk.cycles(4)
    assert [desk.plc.setpoints[0][name] for name in ("KPC", "MOMRED")] == [20_000, 0x2000]
    desk.keys("dM")
    desk.cycles(4)
    assert [desk.plc.setpoints[0][name] for name in ("KPC", "MOMRED")] == [0, 0]


def test_a_stop_ends_the_following_of_a_sine_and_leaves_no_setpoints() -> None:
    desk = Desk(105)
    desk.answer(OPERATION)
    desk.keys("f")
    desk.cycles(100)
    assert desk.plc.setpoints[0]["KPC"]
    assert desk.plc.setpoints[0]["XERR"]
    desk.keys("o")
    desk.cycles(100)
    assert [desk.plc.setpoints[0][name] for name in ("KPC", "XERR", "NSOLL_B")] == [0, 0, 0]
    assert desk.bit("ON") == 0


def test_faster_and_slower_change_the_override_of_a_positioner() -> None:
    desk = Desk(111)
    desk.keys("+++-")
    desk.cycles(5)
    assert desk.plc.setpoints[0]["OVERRIDE"] == 0x4000 * 20 // 100


def test_one_axis_is_named_and_a_block_is_shown_by_its_number() -> None:
    desk = Desk(111)
    assert desk.keyboard.help.startswith("axis 1:  o=OFF1")
    desk.keys(":set {POS_STW1.BLOCK: 5}\n")
    desk.cycles(2)
    console = Console(width=150, record=True, file=io.StringIO())
    console.print(tables(snapshot(desk.plc, "")))
    assert "0005h BLOCK=5" in console.export_text()


def test_met_expectation_is_reported() -> None:
    desk = Desk(1)
    desk.answer(READY)
    desk.keys(":expect {ZSW1.READY_TO_SWITCH_ON: 1}\n")
    desk.cycles(2)
    assert desk.reported == ["expect {ZSW1.READY_TO_SWITCH_ON: 1}, axis 1: ZSW1.READY_TO_SWITCH_ON = 1"]


def test_the_exit_key_leaves() -> None:
    plc = PlcEndpoint([telegram(1)], CYCLE)
    left: list[bool] = []
    keyboard = Keyboard(plc, print, lambda: left.append(True))
    keyboard.press("x")
    keyboard.step(0)
    assert left == [True]


def test_small_terminal_shows_messages_and_reasons() -> None:
    window = Window()
    desk = Desk(111)
    window.take({"snapshot": snapshot(desk.plc, "keys\n" * 7)})
    for number in range(9):
        window.take({"message": f"told {number}"})
    window.reasons = ["PLC lost"]
    console = Console(file=io.StringIO(), width=80, record=True)
    console.print(window.drawing())
    seen = [line.strip() for line in console.export_text().splitlines()[:24]]
    assert {"told 8", "axis 1: PLC lost"} <= {*seen}
