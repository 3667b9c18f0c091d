"""Blocks with PLCopen's names (Motion Control, part 1) and state diagram, based on the blocks of the telegrams.

A block MC_... writes its command to the structure of the axis. PDGW_Axis_Tn executes it with the block of its telegram.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from pdgw.profidrive.telegrams import ApplicationMode, Telegram
from pdgw.tools.plc.library import plain

STATES = (
    "Disabled",
    "Standstill",
    "DiscreteMotion",
    "ContinuousMotion",
    "Homing",
    "Stopping",
    "ErrorStop",
)
"""PLCopen's states by their number in PDGW_AXIS."""
_VELOCITY, _HOMING = 3, 4
_INPUTS = {
    "Position": "LREAL; (* in units of PositionFactor *)",
    "Distance": "LREAL; (* in units of PositionFactor *)",
    "Velocity": "LREAL; (* in units of VelocityFactor; a telegram with a speed: rpm *)",
    "Acceleration": "REAL := 100.0; (* percent *)",
    "Deceleration": "REAL := 100.0; (* percent *)",
}


class Command(NamedTuple):
    """A block that commands a motion: its mode in PDGW_AXIS, its inputs, and the last state that accepts the command."""

    name: str
    text: str
    mode: int
    inputs: tuple[str, ...] = ()
    highest: int = _VELOCITY


_RAMPS = ("Velocity", "Acceleration", "Deceleration")
COMMANDS = (
    Command("MC_MoveAbsolute", "Moves to a position.", 2, ("Position", *_RAMPS)),
    Command("MC_MoveRelative", "Moves by a distance.", 1, ("Distance", *_RAMPS)),
    Command("MC_MoveVelocity", "Moves with a velocity until another command; the sign is the direction.", 3, _RAMPS),
    Command("MC_Home", "Searches the home position, as the gateway's configuration says.", _HOMING, highest=1),
    Command("MC_Halt", "Stops the axis with its ramp; another command may replace it.", 0, highest=_HOMING),
)


def has_axis(telegram: Telegram) -> bool:
    """Whether the telegram has a block PDGW_Axis."""
    return telegram.mode in {ApplicationMode.VELOCITY, ApplicationMode.POSITIONING}


def motion_blocks() -> Iterator[str]:
    """Generate the type of an axis and the blocks MC_..."""
    yield plain("axis_type", {"states": ", ".join(f"{number} {name}" for number, name in enumerate(STATES))})
    yield plain("administration", {})
    yield from map(_command, COMMANDS)


def _command(command: Command) -> str:
    endless = command.mode == _VELOCITY
    values = {
        "name": command.name,
        "text": command.text,
        "mode": str(command.mode),
        "bit": f"{1 << command.mode:04X}",
        "highest": str(command.highest),
        "done": "InVelocity" if endless else "Done",
        "done text": "the axis has the velocity" if endless else "the command is complete",
        "inputs": "\n".join(f"    {name} : {_INPUTS[name]}" for name in command.inputs),
        "assignments": "\n".join(
            f"            Axis.{'Position' if name == 'Distance' else name} := {name};" for name in command.inputs
        ),
        "finish": "InVelocity := Axis.InVelocity;"
        if endless
        else "Done := Axis.Finished = number;\n        Busy := NOT Done;",
    }
    return plain("command", values)
