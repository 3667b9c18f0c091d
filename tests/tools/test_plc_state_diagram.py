"""PLCopen's state diagram and rules of outputs as an oracle: any input at any time, faults, lost frames."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.plc.motion_blocks import POSITIONS, axis_with
from tests.support.plc.plcopen_rules import EXECUTED, Rules

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
