"""PLCopen's rules for motion blocks, written from its published state diagram: an observer without the blocks' code.

Source: PLCopen, Function blocks for motion control, version 2.0, 2.1 (the state diagram) and 2.4 (general rules of inputs and
outputs). It sees what a PLC programmer sees, the inputs and outputs of the blocks, and the shaft.
Three additions of this library, each towards standstill: MC_Halt also ends a homing; a task that the axis refuses stops the
motion that it was to replace; MC_Stop keeps the axis stopped while Execute is TRUE, also when power was off in between.
"""

from __future__ import annotations

from collections.abc import Set
from typing import Any

from tests.support.plc.motion_blocks import Axis

STATE_OF = {
    "absolute": "DiscreteMotion",
    "other": "DiscreteMotion",
    "relative": "DiscreteMotion",
    "halting": "DiscreteMotion",
    "turn": "ContinuousMotion",
    "home": "Homing",
}
"""The state in which a block moves the axis."""
EXECUTED = (*STATE_OF, "stopping", "reset")
_MOTION = {"Standstill", "DiscreteMotion", "ContinuousMotion"}
ALLOWED_IN = {
    **dict.fromkeys(("absolute", "other", "relative", "turn"), _MOTION),
    "home": {"Standstill"},
    "halting": {*_MOTION, "Homing"},
    "stopping": {*_MOTION, "Homing", "Stopping"},
}
"""The states that an arrow with the name of the block leaves."""
NEXT = {
    "Disabled": {"Standstill"},
    "Standstill": {"Homing", "DiscreteMotion", "ContinuousMotion", "Stopping", "Disabled"},
    "Homing": {"Standstill", "DiscreteMotion", "Stopping", "Disabled"},
    "DiscreteMotion": {"Standstill", "ContinuousMotion", "Stopping", "Disabled"},
    "ContinuousMotion": {"DiscreteMotion", "Stopping", "Disabled"},
    "Stopping": {"Standstill", "Disabled"},
    "ErrorStop": {"Standstill", "Disabled"},
}
"""The arrows of the diagram; one to ErrorStop begins in every state."""
_ENDS = ("DONE", "COMMANDABORTED", "ERROR")
_STILL_RPM = 30.0
_COASTING = 20
"""Cycles until the shaft of an axis without a command has to slow down."""


class Rules:
    """Checks one call of the program after the other."""

    def __init__(self, axis: Axis, missing: Set[str] = frozenset()) -> None:
        """``missing``: the blocks that the telegram cannot carry out."""
        self.axis = axis
        self._missing = missing
        self._before = self._outputs()
        self._state = self._seen()
        self._speeds = [abs(axis.rpm)]
        self._idle = 0

    def _outputs(self) -> dict[str, dict[str, Any]]:
        return {name: dict(self.axis.at(name)) for name in EXECUTED}

    def _seen(self) -> str:
        """The state in MC_ReadStatus; an axis without values of the gateway does not follow."""
        status = self.axis.at("status")
        if status["VALID"]:
            return self.axis.state
        assert status["ERROR"], "MC_ReadStatus: neither Valid nor Error"
        return "Disabled"

    def exchange(self, cycles: int = 1) -> None:
        for _ in range(cycles):
            self.axis.exchange()
            self.check()

    def check(self) -> None:
        now, state = self._outputs(), self._seen()
        rising = {name for name in EXECUTED if now[name]["EXECUTE"] and not self._before[name]["EXECUTE"]}
        for name in EXECUTED:
            self._check_outputs(name, self._before[name], now[name], rising)
        self._check_edges(state, now, rising)
        self._check_state(state, now, rising)
        self._check_shaft(state, now)
        self._before, self._state = now, state

    @staticmethod
    def _check_outputs(name: str, before: dict[str, Any], now: dict[str, Any], rising: set[str]) -> None:
        shown = [key for key in ("BUSY", *_ENDS) if now.get(key)]
        assert len(shown) <= 1, f"{name}: {shown} at the same time"
        assert not now["EXECUTE"] or shown, f"{name}: Execute and no output"
        assert not now.get("INVELOCITY") or now["BUSY"], f"{name}: InVelocity without Busy"
        assert bool(now["ERROR"]) == (now["ERRORID"] != 0), f"{name}: Error {now['ERROR']}, ErrorID {now['ERRORID']}"
        ended = [key for key in _ENDS if before.get(key)]
        if now["EXECUTE"] and name not in rising and ended:
            assert shown == ended, f"{name}: {ended} became {shown} while Execute was TRUE"
        if not now["EXECUTE"] and not before["EXECUTE"] and not before["BUSY"]:
            assert not shown, f"{name}: {shown} without Execute"

    def _check_edges(self, state: str, now: dict[str, dict[str, Any]], rising: set[str]) -> None:
        """``state`` is that which the blocks of this call saw."""
        stopping = now["stopping"]
        for name in rising & ALLOWED_IN.keys():
            possible = state in ALLOWED_IN[name] and name not in self._missing
            allowed = possible and not (name != "stopping" and stopping["EXECUTE"] and stopping["BUSY"])
            if allowed and now[name]["ERROR"]:
                raise AssertionError(f"{name} is refused in {state}: {now[name]['ERRORID']}")
            if not possible:
                assert now[name]["ERROR"], f"{name} is accepted in {state}"

    def _check_state(self, state: str, now: dict[str, dict[str, Any]], rising: set[str]) -> None:
        held = {"Stopping"} if now["stopping"]["EXECUTE"] else set()
        assert state in {self._state, "ErrorStop"} | NEXT[self._state] | held or self._refused(now), (
            f"{self._state} -> {state}: {[name for name in EXECUTED if now[name]['BUSY']]}"
        )
        busy = [name for name in STATE_OF if now[name]["BUSY"] and name not in rising]
        if state in set(STATE_OF.values()):
            replaced = [name for name in STATE_OF if now[name]["COMMANDABORTED"] and self._before[name]["BUSY"]]
            assert (len(busy) == 1 and STATE_OF[busy[0]] == state) or rising or replaced or self._refused(now), (
                f"{state}: Busy are {busy}"
            )
        else:
            assert not busy, f"{state}: Busy are {busy}"
        if state == "Stopping" and self._state != "Stopping":
            assert now["stopping"]["EXECUTE"] or now["stopping"]["BUSY"] or self._refused(now), (
                "Stopping without MC_Stop"
            )
        if self._before["stopping"]["BUSY"] and state not in {"Disabled", "ErrorStop"}:
            assert state == "Stopping", f"{state} while MC_Stop is busy"

    def _refused(self, now: dict[str, dict[str, Any]]) -> bool:
        """A task was refused in this call or the one before."""
        return any(now[name]["ERROR"] and self._before[name]["BUSY"] for name in STATE_OF)

    def _check_shaft(self, state: str, now: dict[str, dict[str, Any]]) -> None:
        """Without a command nothing gets faster, and what is at standstill stays there."""
        commanded = any(now[name]["BUSY"] for name in STATE_OF)
        self._idle = 0 if commanded else self._idle + 1
        speed = abs(self.axis.rpm)
        if self._idle > _COASTING:
            assert speed <= max(self._speeds[-1], _STILL_RPM), f"{state}: the shaft got faster without a command"
        self._speeds.append(speed)
