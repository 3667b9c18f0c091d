"""The keys of the PLC simulator, as data: each is a step of a scenario, for the axes whose telegram supports it."""

from __future__ import annotations

import string
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

Action = Mapping[str, Any]

EXIT: Final = "x"
ALL: Final = "0"
"""Digits select an axis, this one selects all."""
TYPE: Final = ":"
"""Starts a typed step, up to Enter: ``override 50 %``, ``mdi {to: 500}``."""
BITS: Final = "t"
"""The next key is the letter of a bit to toggle."""
LIST: Final = "?"
"""Lists the words of the axis' telegram."""
BIT_LETTERS: Final = string.ascii_lowercase + string.ascii_uppercase
FASTER, SLOWER = "+", "-"
CHANGED_BY_KEYS: Final = ("NSOLL_A", "NSOLL_B", "OVERRIDE")
"""``+`` and ``-`` change the first of these in the telegram by ``STEP_PERCENT``."""
STEP_PERCENT: Final = 10


@dataclass(frozen=True, slots=True)
class Key:
    """``back``: replaces the key's step while the word ``withheld`` is not 0."""

    text: str
    step: Action
    held: str = ""
    back: Action | None = None


_TURN: Final = {"by": 4096, "frequency": 0.5, "gain": 20, "error": 400}
_FOLLOW_S: Final = "8 s"

KEYS: Final[Mapping[str, Key]] = {
    "o": Key("OFF1", {"off1": True}),
    "e": Key("enable", {"enable": True}),
    FASTER: Key("faster", {}),
    SLOWER: Key("slower", {}),
    "q": Key("quick stop", {"quick_stop": True}),
    "c": Key("coast stop", {"coast": True}),
    "a": Key("acknowledge", {"ack": True}),
    " ": Key("resume / intermediate stop", {"resume": True}, "no_intermediate_stop", {"intermediate_stop": True}),
    "r": Key("reject", {"reject": True}),
    "h": Key("home / end", {"home": {}}, "start_homing", {"home_end": True}),
    "w": Key("passive homing / end", {"home": {"passive": True}}, "start_homing", {"home_end": True}),
    "s": Key("set reference point", {"set_reference": True}),
    "m": Key("move +10 %", {"move": {"to": "10 %", "relative": True}}),
    "p": Key("+10000 LU", {"mdi": {"to": 10_000, "relative": True}}),
    "u": Key("to 50000 LU, continuous update", {"mdi": {"to": 50_000, "update": True}}),
    "U": Key("to 0 LU, continuous update", {"mdi": {"to": 0, "update": True}}),
    "v": Key("setting up, forward", {"setting_up": {"velocity": 3000}}),
    "V": Key("setting up, backward", {"setting_up": {"velocity": -3000}}),
    "b": Key("block 1", {"block": 1}),
    "n": Key("next block", {"next_block": True}),
    "j": Key("jog 1", {"jog": 1}),
    "k": Key("jog 2", {"jog": 2}),
    "i": Key("jog 1 by its distance", {"jog_distance": 1}),
    "I": Key("jog 2 by its distance", {"jog_distance": 2}),
    "l": Key("let go", {"jog": 0}),
    "d": Key("DSC on / off", {"kpc": 20_000, "xerr": 0}, "kpc", {"kpc": 0, "xerr": 0}),
    "f": Key("follow a sine with DSC", {"follow": _TURN, "within": _FOLLOW_S}),
    "F": Key("follow without DSC", {"follow": {**_TURN, "dsc": False, "gain": 10, "error": 1200}, "within": _FOLLOW_S}),
    "M": Key("half torque / all", {"momred": "50 %"}, "momred", {"momred": 0}),
    "g": Key("reference mark", {"reference_mark": 1}),
    "z": Key("measure probe 1", {"measure": {"function": 1}}),
    "y": Key("show the value", {"read_value": {"function": 1}}),
    "Z": Key("stop measuring", {"stop_measuring": 1}),
    "A": Key("absolute value / off", {"g1_request_absolute": 1}, "g1_request_absolute", {"g1_request_absolute": 0}),
    "P": Key("park sensor 1 / use it", {"g1_park": 1}, "g1_park", {"g1_park": 0}),
    "L": Key("sign of life / none", {"sign_of_life": True}, "sign_of_life", {"sign_of_life": False}),
}
"""The step of each key."""
_STOPS: Final = frozenset({"off1", "quick_stop", "coast", "reject", "intermediate_stop"})


_IN_LU: Final = frozenset({"mdi", "setting_up"})


def in_lu(action: Action) -> bool:
    """Whether its numbers are length units, so that no key fits telegram 112, whose unit only the gateway has."""
    return bool(_IN_LU & set(action))


def stops(action: Action) -> bool:
    """Whether the action takes effect without waiting for active steps."""
    return bool(_STOPS & set(action)) or action.get("jog") == 0


def shown(key: str) -> str:
    """The printed name of a key."""
    return "space" if key == " " else key
