"""Keyboard of the PLC simulator, sans-I/O: keys and typed words become steps of a scenario on the selected axes.

The keys are data: each is a step of a scenario, for the axes whose telegram supports it.
"""

from __future__ import annotations

import queue
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

from pdgw.gateway.base.errors import GatewayError
from pdgw.peers.plc.engine import Engine
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.peers.plc.notation import words_of
from pdgw.peers.plc.scenario import ACTIONS, examples
from pdgw.peers.plc.scenario_file import parse_step, scenario_of

StepKeys = Mapping[str, Any]
"""A step of a scenario, as its file has it."""

EXIT: Final = "x"
ALL: Final = "0"
"""Digits select an axis, this one selects all."""
TYPE: Final = ":"
"""Starts a typed step, up to Enter: ``override 50 %``, ``mdi {to: 500}``."""
LIST: Final = "?"
"""Lists the words of the axis' telegram."""
FASTER, SLOWER = "+", "-"
CHANGED_BY_KEYS: Final = ("NSOLL_A", "NSOLL_B", "OVERRIDE")
"""``+`` and ``-`` change the first of these in the telegram by ``STEP_PERCENT``."""
STEP_PERCENT: Final = 10


@dataclass(frozen=True, slots=True)
class Key:
    """``back``: replaces the key's step while the word ``held`` is not 0."""

    text: str
    step: StepKeys
    held: str = ""
    back: StepKeys | None = None


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
    "h": Key("home / end", {"home": {}}, "start_homing", {"stop_homing": True}),
    "w": Key("passive homing / end", {"home": {"passive": True}}, "start_homing", {"stop_homing": True}),
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
"""Their numbers are length units, so that no key fits telegram 112, whose unit only the gateway has."""


def stops(action: StepKeys) -> bool:
    """Whether the action takes effect without waiting for active steps."""
    return bool(_STOPS & set(action)) or action.get("jog") == 0


def shown(key: str) -> str:
    """The printed name of a key."""
    return "space" if key == " " else key


_ENTER: Final = ("\r", "\n")
_BACKSPACE: Final = ("\x7f", "\b")
_ESCAPE: Final = "\x1b"
_FULL: Final = 100
_ABORTED_BY_STOPS: Final = {"enable", "follow"}
_REPORTED: Final = frozenset({"follow", "expect"})
"""Their results are reported after a success as well."""
_OF_SCENARIOS: Final = frozenset({"read", "write", "mute", "drive"})
"""They need more than cyclic frames, which is all that keys control."""
_WHERE: Final = re.compile(r"\bstep 1(?: \(\w+\))?: ")
"""The place in an error message of a scenario. A typed step is always step 1."""


@dataclass(slots=True)
class _Job:
    """A queued step of an axis. ``action`` is called when the step starts; then ``engine`` runs it."""

    text: str
    action: Callable[[], StepKeys]
    engine: Engine | None = None


class Keyboard:
    """Converts keys to setpoints, sans-I/O: ``press`` from any thread, ``step`` once per cycle.

    Each axis has its own queue of keys. A stop key acts at once: it clears the queue, aborts an enable that waits for the
    drive, and lets only a started handshake finish. ``report`` is called with messages for the user, ``leave`` for the exit
    key.
    """

    def __init__(
        self, endpoint: PlcEndpoint, report: Callable[[str], None], leave: Callable[[], None] = lambda: None
    ) -> None:
        self.endpoint = endpoint
        self.report = report
        self.selected: int | None = None
        """The selected axis (from 1); None: all."""
        self._leave = leave
        self._numbers = [item.number for item in endpoint.telegrams]
        self._keys: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._typed: str | None = None
        """The line being typed."""
        self._pending: list[list[_Job]] = [[] for _ in self._numbers]
        keys = {number: set(self.keys_of(self._numbers.index(number) + 1)) for number in dict.fromkeys(self._numbers)}
        self._available = [keys[number] for number in self._numbers]

    def press(self, key: str) -> None:
        """Queue a key; an unknown one has no effect."""
        self._keys.put(key)

    def step(self, now: int) -> None:
        """Carry out the keys pressed since the last cycle and continue the active steps."""
        while not self._keys.empty():
            self._execute(self._keys.get(), now)
        for axis, pending in enumerate(self._pending, 1):
            if pending:
                job = pending[0]
                if job.engine is None:
                    job.engine = self._engine(axis, job.action())
                job.engine.step(now)
                if job.engine.finished:
                    pending.pop(0)
                    self._report_results(job.text, job.engine)

    def keys_of(self, axis: int) -> list[str]:
        """The keys whose step is possible with the telegram of an axis."""
        changed = self._changed_by_keys(axis) is not None
        floats = any(item.is_float for item in self.endpoint.telegrams[axis - 1].setpoints.signals)
        return [
            key
            for key, item in KEYS.items()
            if not (floats and _IN_LU & set(item.step))
            and (changed if key in (FASTER, SLOWER) else self._possible(axis, item.step))
        ]

    @property
    def help(self) -> str:
        """The selected axes with their keys, or the line being typed."""
        chosen = "all axes" if len(self._chosen) > 1 else f"axis {self._chosen[0]}"
        if self._typed is not None:
            return f"{chosen}  {TYPE}{self._typed}_   (Enter runs it, Esc cancels it)"
        keys = [key for key in KEYS if any(key in self._available[axis - 1] for axis in self._chosen)]
        texts = [f"{shown(key)}={KEYS[key].text}" for key in keys]
        if len(self._numbers) > 1:
            texts.append(f"1..{min(9, len(self._numbers))}=axis, {ALL}=all")
        texts += [f"{TYPE}=type a word", f"{LIST}=words", f"{EXIT}=exit"]
        return f"{chosen}:  {'  '.join(texts)}"

    @property
    def _chosen(self) -> range:
        return range(1, len(self._numbers) + 1) if self.selected is None else range(self.selected, self.selected + 1)

    def _changed_by_keys(self, axis: int) -> str | None:
        names = self.endpoint.telegrams[axis - 1].setpoints.names
        return next((name for name in CHANGED_BY_KEYS if name in names), None)

    def _engine(self, axis: int, action: StepKeys) -> Engine:
        return Engine(scenario_of(self.endpoint.telegrams, [{"axis": axis, **action}]), self.endpoint)

    def _possible(self, axis: int, action: StepKeys) -> bool:
        try:
            self._engine(axis, action)
        except GatewayError:
            return False
        return True

    def _report_results(self, text: str, engine: Engine) -> None:
        for result in engine.results:
            if not result.passed:
                self.report(f"{text}, axis {result.axis}: {result.name} not met: {result.measured}")
            elif engine.scenario.steps[0].action in _REPORTED:
                self.report(f"{text}, axis {result.axis}: {result.measured}")

    def _execute(self, key: str, now: int) -> None:
        if self._typed is not None:
            self._type(key, now)
        elif key == TYPE:
            self._typed = ""
        elif key == LIST:
            self._list()
        elif key == EXIT:
            self._leave()
        elif key.isdecimal():
            self._select(key)
        elif key in KEYS:
            self._press(key, now)

    def _press(self, key: str, now: int) -> None:
        for axis in self._chosen:
            if key in self._available[axis - 1]:
                self._do(axis, KEYS[key].text, partial(self._action, key, axis), now)
            elif self.selected is not None or not any(key in keys for keys in self._available):
                number = self._numbers[axis - 1]
                self.report(f"{KEYS[key].text}, axis {axis}: telegram {number} does not use this key")

    def _type(self, key: str, now: int) -> None:
        line = self._typed or ""
        if key == _ESCAPE:
            self._typed = None
        elif key in _BACKSPACE:
            self._typed = line[:-1]
        elif key not in _ENTER:
            self._typed = line + key
        else:
            self._typed = None
            if line.strip():
                self._queue_line(line.strip(), now)

    def _queue_line(self, line: str, now: int) -> None:
        """Queue a typed step for each selected axis whose telegram supports it."""
        refusals = []
        for axis in self._chosen:
            try:
                action = parse_step(line)
                for name in _OF_SCENARIOS & set(action):
                    raise GatewayError(f"{name}: allowed only in a scenario (pdgw sim plc FILE)")
                self._engine(axis, action)
            except GatewayError as error:
                refusals.append(_WHERE.sub("", str(error)))
            else:
                self._do(axis, line, partial(dict, action), now)
        if len(refusals) == len(self._chosen):
            for text in dict.fromkeys(refusals):
                self.report(text)

    def _value(self, axis: int, name: str) -> int:
        word = words_of(self.endpoint.telegrams[axis - 1].setpoints)[name]
        return word.of(self.endpoint.setpoints[axis - 1])

    def _list(self) -> None:
        for number in dict.fromkeys(self._numbers[axis - 1] for axis in self._chosen):
            axis = self._numbers.index(number) + 1
            actions = [
                name
                for name in ACTIONS
                if name not in _OF_SCENARIOS and any(self._possible(axis, example) for example in examples(name))
            ]
            words = words_of(self.endpoint.telegrams[axis - 1].setpoints)
            self.report(f"telegram {number}: {', '.join(dict.fromkeys([*actions, *words]))}")

    def _select(self, key: str) -> None:
        if key == ALL:
            self.selected = None
        elif int(key) <= len(self._numbers):
            self.selected = int(key)
        else:
            self.report(f"axis {key}: does not exist, the number of axes is {len(self._numbers)}")

    def _action(self, key: str, axis: int) -> StepKeys:
        name = self._changed_by_keys(axis)
        if key in (FASTER, SLOWER) and name is not None:
            item = self.endpoint.telegrams[axis - 1].setpoints.signal(name)
            now = round(item.percent(self.endpoint.setpoints[axis - 1][name]) or 0)
            percent = now + (STEP_PERCENT if key == FASTER else -STEP_PERCENT)
            return {"set": {name: f"{max(-_FULL, min(_FULL, percent))} %"}}
        item_of = KEYS[key]
        if item_of.back is not None and self._value(axis, item_of.held):
            return item_of.back
        return item_of.step

    def _do(self, axis: int, text: str, make: Callable[[], StepKeys], now: int) -> None:
        """Queue a step, or run it at once if it stops the axis."""
        pending = self._pending[axis - 1]
        action = make()
        if not stops(action):
            pending.append(_Job(text, make))
            return
        for other in pending:
            if other.engine is not None and other.engine.scenario.steps[0].action in _ABORTED_BY_STOPS:
                other.engine.abort()
        pending[:] = [other for other in pending if other.engine is not None and not other.engine.finished]
        self._engine(axis, action).step(now)
