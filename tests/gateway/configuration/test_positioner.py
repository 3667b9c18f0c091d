"""[axis.positioner] and [[axis.block]]."""

from __future__ import annotations

import pytest

from pdgw.gateway.configuration.file import parse_config
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.motion.blocks import Block, BlockNext

BASE = """\
[can]
interface = "virtual"
channel = "x"
[[axis]]
do_id = 1
node_id = 1
telegram = 111
[axis.positioner]
lu_per_revolution = 10000
max_velocity = 30000
max_acceleration = 2000
max_deceleration = 2000
position_window = 20
software_limits = [-5, 9]
homing_method = 35
[[axis.block]]
number = 1
position = 5000
velocity = 300
next = "continue-with-stop"
[[axis.block]]
number = 2
task = "wait"
value = 10
"""


def test_all_keys_reach_the_axis() -> None:
    choices = parse_config(BASE).axis[0].settings_at(4).positioner
    assert choices is not None
    assert (choices.lu_per_revolution, choices.software_limits, choices.homing_method) == (10_000, (-5, 9), 35)
    assert choices.jog_velocities == (-300, 300)
    assert choices.blocks[0] == Block(1, 5000, 300, next=BlockNext.CONTINUE_WITH_STOP)
    assert len(choices.blocks) == 2
    assert choices.modulo == 0
    rotary = parse_config(BASE.replace("software_limits = [-5, 9]", "modulo_range = 360")).axis[0].settings_at(4)
    assert rotary.positioner is not None
    assert rotary.positioner.modulo == 360


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        (
            "lu_per_revolution = 10000\n",
            "",
            ["x.toml:4", "[[axis]] number 1", "positioner.lu_per_revolution", "missing"],
        ),
        ("max_velocity = 30000", "max_velocity = 0", ["x.toml:4", "positioner.max_velocity = 0", "1 to"]),
        ("software_limits = [-5, 9]", "software_limits = [9, 9]", ["software_limits = [9, 9]", "below"]),
        ("value = 10", "value = -1", ["value = -1"]),
        (
            "software_limits = [-5, 9]",
            "software_limits = [-5, 9]\nmodulo_range = 360",
            ["software_limits: not allowed with modulo_range"],
        ),
        (
            "software_limits = [-5, 9]",
            "reference_coordinate = 360\nmodulo_range = 360",
            ["reference_coordinate = 360: allowed 0 to 359"],
        ),
        (
            "homing_method = 35",
            "modulo_correction = true",
            ["positioner.modulo_correction: was removed in 0.9.0: modulo_range"],
        ),
        ("5000\nvelocity = 300", "5000\nvelocity = 0", ["block 1: velocity = 0 is not allowed"]),
        (
            'task = "wait"\nvalue = 10',
            'task = "fixed-stop"\nvalue = 1001\nvelocity = 5',
            ["block 2: value = 1001 is not allowed, expected 1..1000"],
        ),
        ('task = "wait"', 'task = "jump"', ["task = 'jump'", "'position', 'wait', 'goto'"]),
        ("number = 2", "number = 3", ["block 1: continues with block 2, which is missing"]),
        ("position_window", "position_windov", ["position_windov", "did you mean position_window"]),
    ],
)
def test_what_is_wrong_is_told_with_its_place(old: str, new: str, parts: list[str]) -> None:
    assert old in BASE
    with pytest.raises(GatewayError) as error:
        parse_config(BASE.replace(old, new, 1), "x.toml")
    for part in parts:
        assert part in str(error.value), str(error.value)


@pytest.mark.parametrize("number", [7, 110, 111])
def test_a_positioning_telegram_needs_the_positioner(number: int) -> None:
    text = BASE[: BASE.index("[axis.positioner]")].replace("111", str(number))
    with pytest.raises(GatewayError, match=rf"telegram = {number} needs \[axis.positioner\]"):
        parse_config(text)
