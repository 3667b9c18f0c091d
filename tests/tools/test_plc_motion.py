"""PLCopen's blocks on every telegram in virtual time, with the state diagram and the rules of outputs as an oracle.

The program of examples/ runs on two telegrams.
"""

from __future__ import annotations

import re
import textwrap
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pdgw.base.durations import SECOND
from pdgw.dsp402.states import State
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.configuration.file import load_config
from pdgw.tools.plc.code import structured_text
from tests.support.gateways.daemon import drive_of, running
from tests.support.plc.motion_blocks import POSITIONS, VELOCITIES, Axis, axis_with
from tests.support.plc.plcopen_rules import EXECUTED, Rules
from tests.support.plc.structured_text import TextPlc, config_of

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
EXAMPLE = (EXAMPLES / "axis_sequence.st").read_text()
OF_9 = (
    ("PDGW_Axis_T111", "PDGW_Axis_T9"),
    # 100 % of the position are 500000 of 4096 counts in a revolution, 100 % of the speed 3000 rpm.
    ("PositionFactor := 10000.0", "HomingMethod := 35, PositionFactor := 8796093.0"),
    ("VelocityFactor := 600.0", "VelocityFactor := 21474836.0"),
)


def program_of(number: int) -> str:
    text = EXAMPLE
    for before, after in OF_9 if number == 9 else ():
        assert before in text
        text = text.replace(before, after)
    return text


def fault_and_reset(axis: Axis, moving: str) -> None:
    """ErrorStop until MC_Reset, then Disabled until MC_Power has seen FALSE."""
    axis.drive.node.model.inject(5)
    axis.until(lambda _: axis.state == "ErrorStop", "ErrorStop")
    axis.exchange(2)
    assert axis.at(moving)["ERROR"] or axis.at(moving)["COMMANDABORTED"]
    axis.start("turn", Velocity=100.0)
    axis.ends("turn", "ERROR")
    assert axis.at("turn")["ERRORID"] == Reason.DRIVE_FAULT.code
    axis.drive.node.model.clear()
    axis.start("reset")
    axis.until(lambda _: axis.at("reset")["DONE"], "reset")
    axis.exchange(150)
    assert (axis.state, axis.rpm, axis.drive.node.model.state is State.OPERATION_ENABLED) == ("Disabled", 0, False)
    axis.on()
    axis.exchange(100)
    assert axis.rpm == 0, "what was commanded before is forgotten"


def rejects_unsupported_functions(axis: Axis, number: int) -> None:
    """At standstill with power."""
    names = {"absolute", "relative", "home"} if number in VELOCITIES and number not in {111, 112} else set()
    names |= {7: {"absolute", "relative", "turn"}, 9: {"turn"}, 110: {"turn"}}.get(number, set())
    for name in sorted(names):
        if name == "home":
            axis.start(name)
        else:
            axis.start(name, Velocity=100.0)
        axis.ends(name, "ERROR")
        assert (axis.state, axis.rpm) == ("Standstill", 0)
        assert axis.at(name)["ERRORID"] == Reason.MODE_VALUE.code


@pytest.mark.parametrize("number", VELOCITIES)
def test_an_axis_of_each_telegram_turns_and_reverses(number: int) -> None:
    with axis_with(number) as axis:
        axis.until(lambda _: axis.drive.node.model.state is State.READY_TO_SWITCH_ON, "ready")
        axis.exchange(5)
        assert axis.state == "Disabled"
        axis.start("turn", Velocity=600.0)
        axis.ends("turn", "ERROR")
        axis.on()
        rejects_unsupported_functions(axis, number)
        axis.start("turn", Velocity=600.0)
        axis.exchange(5)
        assert (axis.state, axis.at("turn")["INVELOCITY"]) == ("ContinuousMotion", False)
        axis.ends("turn", "INVELOCITY")
        assert axis.rpm == pytest.approx(600, abs=15)
        axis.start("turn", Velocity=-300.0)
        axis.ends("turn", "INVELOCITY")
        assert axis.rpm == pytest.approx(-300, abs=15) or number == 112


@pytest.mark.parametrize("number", [1, 105, 111, 112])
def test_an_axis_that_turns_halts_stops_and_resets(number: int) -> None:
    with axis_with(number) as axis:
        axis.on()
        axis.start("turn", Velocity=600.0)
        axis.ends("turn", "INVELOCITY")
        axis.start("halting")
        axis.exchange(5)
        assert (axis.state, axis.at("turn")["COMMANDABORTED"]) == ("DiscreteMotion", True)
        axis.ends("halting")
        axis.exchange(2)
        assert (axis.state, axis.rpm) == ("Standstill", pytest.approx(0, abs=30))
        axis.start("turn", Velocity=600.0)
        axis.ends("turn", "INVELOCITY")
        axis.start("stopping")
        axis.exchange(5)
        assert (axis.state, axis.at("turn")["COMMANDABORTED"]) == ("Stopping", True)
        axis.ends("stopping")
        axis.start("turn")
        axis.ends("turn", "ERROR")
        axis.at("stopping")["EXECUTE"] = False
        axis.exchange(50)
        assert (axis.state, axis.rpm) == ("Standstill", 0)
        axis.start("turn", Velocity=600.0)
        axis.exchange(100)
        fault_and_reset(axis, "turn")


@pytest.mark.parametrize("number", POSITIONS)
def test_an_axis_homes_moves_replaces_stops_and_resets(number: int) -> None:
    with axis_with(number) as axis:
        axis.on()
        rejects_unsupported_functions(axis, number)
        assert not axis.at("position")["VALID"]
        axis.start("home")
        axis.exchange(2)
        assert axis.state == "Homing"
        axis.ends("home")
        assert axis.at("position")["VALID"]
        axis.start("absolute", Position=3.0, Velocity=600.0)
        axis.exchange(5)
        assert axis.state == "DiscreteMotion"
        axis.ends("absolute")
        axis.exchange(100)
        assert (axis.state, axis.turns) == ("Standstill", pytest.approx(3, abs=0.01))
        assert axis.at("position")["POSITION"] == pytest.approx(3, abs=0.01)
        axis.start("relative", Distance=-1.0, Velocity=600.0)
        axis.ends("relative")
        axis.exchange(100)
        assert axis.turns == pytest.approx(2, abs=0.01)
        axis.start("absolute", Position=40.0, Velocity=600.0)
        axis.exchange(50)
        axis.start("other", Position=5.0, Velocity=600.0)
        axis.exchange(2)
        assert axis.at("absolute")["COMMANDABORTED"]
        axis.ends("other")
        axis.exchange(100)
        assert axis.turns == pytest.approx(5, abs=0.01)
        axis.start("absolute", Position=40.0, Velocity=600.0)
        axis.exchange(50)
        axis.start("halting")
        axis.ends("halting")
        axis.exchange(2)
        assert (axis.state, axis.rpm) == ("Standstill", 0)
        axis.start("absolute", Position=40.0, Velocity=600.0)
        axis.exchange(50)
        axis.start("stopping")
        axis.ends("stopping")
        assert axis.at("absolute")["COMMANDABORTED"]
        axis.at("stopping")["EXECUTE"] = False
        axis.exchange(20)
        assert (axis.state, axis.rpm) == ("Standstill", 0)
        axis.start("absolute", Velocity=0.0)
        axis.ends("absolute", "ERROR")
        assert axis.at("absolute")["ERRORID"] == Reason.TASK_SPEED_ZERO.code
        axis.start("absolute", Position=40.0, Velocity=600.0)
        axis.exchange(50)
        fault_and_reset(axis, "absolute")


def test_block_of_telegram_7_rejects_unsupported_functions() -> None:
    with axis_with(7) as axis:
        axis.on()
        rejects_unsupported_functions(axis, 7)


@pytest.mark.parametrize("number", [1, 110])
def test_a_command_the_telegram_lacks_leaves_the_motion_going(number: int) -> None:
    moving, lacking = ("turn", "absolute") if number == 1 else ("absolute", "turn")
    with axis_with(number) as axis:
        axis.on()
        if number == 110:
            axis.start("home")
            axis.ends("home")
        axis.start(moving, Velocity=600.0, **({} if number == 1 else {"Position": 40.0}))
        axis.exchange(100)
        axis.start(lacking, Velocity=600.0)
        axis.ends(lacking, "ERROR")
        axis.exchange(100)
        assert axis.at(moving)["BUSY"]
        assert axis.rpm == pytest.approx(600, abs=10)


def test_halt_right_after_a_move_prevents_the_motion() -> None:
    with axis_with(111) as axis:
        axis.on()
        axis.start("home")
        axis.ends("home")
        axis.start("absolute", Position=40.0, Velocity=600.0)
        axis.at("halting")["EXECUTE"] = True
        axis.exchange()
        axis.ends("halting")
        axis.exchange(250)
        assert (axis.state, axis.turns) == ("Standstill", pytest.approx(0, abs=0.01))


def test_an_axis_stays_stopped_until_the_last_of_two_stops_ends() -> None:
    with axis_with(1) as axis:
        axis.on()
        axis.start("stopping")
        axis.start("stopping_too")
        axis.ends("stopping")
        axis.ends("stopping_too")
        axis.at("stopping_too")["EXECUTE"] = False
        axis.exchange(5)
        assert axis.state == "Stopping"
        axis.at("stopping")["EXECUTE"] = False
        axis.exchange(5)
        assert axis.state == "Standstill"


def test_reset_acknowledges_a_fault_of_the_past_in_operation() -> None:
    with axis_with(1) as axis:
        axis.on()
        axis.loop.run_for(SECOND)
        axis.exchange(100)
        axis.on()
        assert axis.daemon.axes[0].actuals[0] & 0x08, "fault 103 is not acknowledged"
        axis.start("reset")
        axis.until(lambda _: axis.at("reset")["DONE"], "reset")
        axis.exchange(10)
        assert not axis.daemon.axes[0].actuals[0] & 0x08
        assert axis.state == "Standstill"


def test_reset_reports_a_fault_that_stays() -> None:
    with axis_with(1) as axis:
        axis.on()
        axis.drive.node.model.inject(5)
        axis.until(lambda _: axis.state == "ErrorStop", "ErrorStop")
        axis.start("reset")
        axis.at("reset")["EXECUTE"] = False
        axis.exchange(900)
        assert axis.at("reset")["BUSY"], "a falling Execute does not end it"
        axis.until(lambda _: axis.at("reset")["ERROR"], "given up")
        assert axis.at("reset")["ERRORID"] == Reason.DRIVE_FAULT.code
        axis.exchange(2)
        assert not axis.at("reset")["ERROR"]


def run_example(plc: TextPlc) -> dict[int, float]:
    """Run the program of the examples with a fault in the third move; the position at the begin of each stage, in revolutions."""
    model = drive_of(plc.daemon).node.model
    turns = {}
    stage = 0
    for _ in range(8000):
        plc.exchange()
        now = plc.controller.variables["STAGE"]
        if now != stage:
            turns[now] = model.position_actual / 4096
            stage = now
        if stage == 5 and model.position_actual > 6 * 4096:
            model.inject(5)
        if stage == 6:
            model.clear()
        if plc.controller.finished:
            break
    assert plc.controller.finished, (stage, plc.controller.variables["AXIS_1"])
    return turns


@pytest.mark.parametrize("number", [9, 111])
def test_example_program_passes(number: int) -> None:
    config = config_of(number)
    with running(config) as daemon:
        turns = run_example(TextPlc(daemon, structured_text(config) + program_of(number)))
        model = drive_of(daemon).node.model
        assert [turns[n] for n in (2, 3, 4, 5)] == pytest.approx([0, 0, 3, 2], abs=0.01)
        assert turns[6] > 6, "the third move was under way"
        assert turns[8] == pytest.approx(turns[7], abs=0.01), "nothing moves after the fault before the jog"
        jog = turns[11] - turns[8]
        assert jog == pytest.approx(-1 if number == 9 else 5, abs=0.5 if number == 111 else 0.01)
        assert model.state is not State.OPERATION_ENABLED


def test_the_program_of_the_document_homes_and_moves_three_revolutions() -> None:
    document = (EXAMPLES.parent / "plc.md").read_text(encoding="utf-8")
    text = textwrap.dedent(re.search(r"^ +PROGRAM Main$.*?END_PROGRAM$", document, re.DOTALL | re.MULTILINE)[0])
    config = load_config(EXAMPLES / "axis_sequence.toml")
    with running(config) as daemon:
        plc, model = TextPlc(daemon, structured_text(config) + text), drive_of(daemon).node.model
        variables = plc.controller.variables
        plc.until(lambda block: variables["IO"]["AXIS_1_GOOD"] and not variables["REASON"], "no reason")
        variables["START"] = True
        plc.until(lambda block: variables["ABSOLUTE"]["DONE"], "the move")
        plc.exchange(100)
        assert model.position_actual / 4096 == pytest.approx(3, abs=0.01)


WAITS = (1, 1, 2, 6, 30, 100)
"""Calls of the program between two changes of its inputs."""
STEPS = st.one_of(
    st.tuples(
        st.sampled_from(EXECUTED), st.sampled_from((-2.0, 0.0, 1.0, 3.0)), st.sampled_from((0.0, 300.0, 600.0, 600.0))
    ),
    st.tuples(st.sampled_from(EXECUTED), st.just("falls"), st.none()),
    st.tuples(st.just("power"), st.booleans(), st.none()),
    st.tuples(st.sampled_from(("fault", "recover", "recover", "deaf", "heard", "silent")), st.none(), st.none()),
)
MISSING = {
    1: {"absolute", "other", "relative", "home"},
    3: {"absolute", "other", "relative", "home"},
    9: {"turn"},
    110: {"turn"},
    111: set[str](),
    112: set[str](),
}
"""What the telegram has no bits for."""


def step(rules: Rules, name: str, value: object, speed: float | None) -> None:
    axis = rules.axis
    if name == "power":
        axis.at("power")["ENABLE"] = value
    elif name == "fault":
        axis.drive.node.model.inject(5)
    elif name == "recover":
        axis.deaf = False
        axis.drive.node.model.clear()
        axis.at("power")["ENABLE"] = axis.at("reset")["EXECUTE"] = False
        rules.exchange(60)
        axis.at("reset")["EXECUTE"] = True
        rules.exchange(250)
        axis.at("power")["ENABLE"] = True
        rules.exchange(60)
    elif name in {"deaf", "heard"}:
        axis.deaf = name == "deaf"
    elif name == "silent":
        axis.loop.run_for(400 * axis.daemon.cycle_ns)
    else:
        block = axis.at(name)
        block["EXECUTE"] = value != "falls"
        for key in ("POSITION", "DISTANCE"):
            if key in block and value != "falls":
                block[key] = value
        if "VELOCITY" in block and speed is not None:
            block["VELOCITY"] = speed


@pytest.mark.parametrize(("number", "programs"), [(1, 3), (3, 1), (9, 1), (110, 1), (111, 3), (112, 1)])
def test_blocks_follow_the_state_diagram_with_any_program(number: int, programs: int) -> None:
    @settings(max_examples=programs)
    @given(st.lists(st.tuples(STEPS, st.sampled_from(WAITS)), min_size=12, max_size=25))
    def runs(steps: list[tuple[tuple[str, object, float | None], int]]) -> None:
        with axis_with(number) as axis:
            axis.on()
            if number in POSITIONS:
                axis.start("home")
                axis.ends("home")
                axis.at("home")["EXECUTE"] = False
                axis.exchange(2)
            rules = Rules(axis, MISSING[number])
            for (name, value, speed), cycles in steps:
                step(rules, name, value, speed)
                rules.exchange(cycles)
            axis.deaf = False
            axis.at("power")["ENABLE"] = False
            rules.exchange(400)
            assert (axis.state in {"Disabled", "ErrorStop"}, axis.rpm) == (True, 0)

    runs()
