"""The PLC's view of its values, and its position loop.

The view is plain data, and tables for a terminal: words by bit, values, and why values are missing. ``follow``: the PLC closes
the position loop (``PositionLoop``), and the axis follows a sine until the following error is small enough. The target
oscillates between the start position and one ahead of it. It starts and ends each period at rest, and pauses while the PLC
itself is delayed. If the axis is stopped and stays far from the target, the next period starts at its position. The axis has
no load.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import zip_longest
from typing import Annotated, Any, Final

from pydantic import BaseModel, ConfigDict, Field
from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from pdgw.base.durations import MS, SECOND, SECONDS_PER_MINUTE
from pdgw.gateway.motion.dsc_setpoint import KPC_PER_UNIT
from pdgw.gateway.motion.modulo import difference
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.profidrive.datatypes import N4_100_PERCENT, DataType
from pdgw.profidrive.signal_text import texts
from pdgw.profidrive.telegrams import Telegram, telegram


def snapshot(endpoint: PlcEndpoint, title: str) -> dict[str, Any]:
    """All axes as plain data."""
    return {
        "title": title,
        "axes": [
            {
                "telegram": item.number,
                "setpoints": endpoint.setpoints[axis],
                "actuals": endpoint.actuals[axis],
                "why": endpoint.why_no_values(axis) if endpoint.actuals[axis] is None else "",
            }
            for axis, item in enumerate(endpoint.telegrams)
        ],
    }


def line_of(document: Mapping[str, Any]) -> str:
    """A document of the progress as a line for a person; empty if it needs none."""
    if "message" in document:
        return str(document["message"])
    if "note" in document:
        return f"{document['time_s']:7.3f} s  {document['note']}"
    result = document.get("result", {"passed": True})
    return "" if result["passed"] else f"{result['time_s']:7.3f} s  FAILED {result['name']}: {result['measured']}"


def tables(found: dict[str, Any], reasons: Sequence[str] = ()) -> RenderableType:
    """A snapshot as tables. ``reasons``: why the gateway does not execute an axis' command, if known."""
    parts: list[RenderableType] = [Text(found["title"], style="bold")]
    for index, axis in enumerate(found["axes"]):
        chosen = telegram(axis["telegram"])
        reason = axis["why"] or (reasons[index] if index < len(reasons) else "")
        if reason:
            parts.append(Text(f"axis {index + 1}: {reason}", style="yellow"))
        title = f"axis {index + 1}, telegram {axis['telegram']}"
        grid = Table(
            "setpoint", "", "actual value", "", title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False
        )
        sent, received = texts(chosen.setpoints, axis["setpoints"]), texts(chosen.actuals, axis["actuals"] or {})
        for left, right in zip_longest(sent.items(), received.items(), fillvalue=("", "")):
            grid.add_row(*left, *right)
        parts.append(grid)
    return Group(*parts)


POSITION: Final = "G1_XIST1"
_LONGEST_STEP_NS: Final = 20 * MS
_LOWEST, _HIGHEST = DataType.N4.integer_range


class PositionLoop:
    """A proportional position controller like that of a PLC program, over telegrams 5, 6, 105 and 106, with and without DSC.

    Source: docs/motion.md "DSC". Positions are increments of G1_XIST1, speeds rpm. Not implemented: feed-forward of the
    acceleration. ``gain`` in 1/s. ``dsc``: send gain and error to the drive (KPC, XERR), else their product as NSOLL_B.
    """

    def __init__(self, gain: float, *, dsc: bool, increments_per_revolution: int, reference_rpm: float) -> None:
        self.gain = gain
        self.dsc = dsc
        self._increments = increments_per_revolution
        self._reference = reference_rpm
        self.error = 0.0
        """Error of the last step, increments."""

    def step(self, target: float, actuals: Mapping[str, int], feed_forward_rpm: float = 0.0) -> dict[str, int]:
        """The setpoints of one cycle for a target, from the actual values of the last frame."""
        whole = round(target)
        self.error = target - whole + difference(whole, actuals["G1_XIST1"])
        if self.dsc:
            kpc = round(self.gain * KPC_PER_UNIT)
            return {"NSOLL_B": self._speed(feed_forward_rpm), "XERR": round(self.error), "KPC": kpc}
        rpm = self.gain * self.error / self._increments * SECONDS_PER_MINUTE
        return {"NSOLL_B": self._speed(feed_forward_rpm + rpm), "XERR": 0, "KPC": 0}

    def _speed(self, rpm: float) -> int:
        return max(_LOWEST, min(round(rpm / self._reference * N4_100_PERCENT), _HIGHEST))


class Follow(BaseModel):
    """``by``, ``error``: increments of G1_XIST1. ``frequency``: Hz. ``gain``: 1/s.

    ``feed_forward``: NSOLL_B includes the speed of the target.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    by: Annotated[int, Field(gt=0, lt=1 << 30)]
    frequency: Annotated[float, Field(gt=0, le=10, allow_inf_nan=False)] = 0.5
    gain: Annotated[float, Field(gt=0, le=1000, allow_inf_nan=False)] = 20
    error: Annotated[int, Field(gt=0)]
    dsc: bool = True
    feed_forward: bool = False


def can_follow(telegram: Telegram, *, dsc: bool) -> bool:
    """Whether the telegram has a speed setpoint, a position, and with DSC its two values."""
    needed = {"NSOLL_B", "XERR", "KPC"} if dsc else {"NSOLL_B"}
    return needed <= set(telegram.setpoints.names) and POSITION in telegram.actuals.names


class Following:
    """One ``follow`` of an axis. ``within``: nanoseconds from its first step."""

    def __init__(self, wish: Follow, within: int, *, increments: int, rpm: float, dsc: bool) -> None:
        """``increments``: per revolution. ``rpm``: 100 %. ``dsc``: the telegram has XERR and KPC."""
        self._end = within
        self._begun = False
        form = f"gain {wish.gain:g}/s, {'DSC' if wish.dsc else 'no DSC'}"
        self.name = f"follows a sine of {wish.by} increments at {wish.frequency:g} Hz within {wish.error} ({form})"
        self.rest: dict[str, int] = {"NSOLL_B": 0, **({"XERR": 0, "KPC": 0} if dsc else {})}
        """The setpoints at its end."""
        self._wish = wish
        self._increments = increments
        self._loop = PositionLoop(wish.gain, dsc=wish.dsc, increments_per_revolution=increments, reference_rpm=rpm)
        self._base: int | None = None
        self._before = 0
        self._turn = 0.0
        self._worst = 0.0
        self._seen: list[float] = []

    @property
    def passed(self) -> bool:
        """Whether the last complete period was within its bound."""
        return bool(self._seen) and self._seen[-1] <= self._wish.error

    @property
    def measured(self) -> str:
        """The measured values, for the report."""
        if not self._seen:
            return "no whole period"
        periods = "" if len(self._seen) == 1 else f" in period {len(self._seen)}"
        return f"largest error {self._seen[-1]:.0f} increments{periods}"

    def step(self, now: int, actuals: Mapping[str, int] | None) -> dict[str, int] | None:
        """The setpoints of one cycle; None at the end or after the timeout."""
        if not self._begun:
            self._begun = True
            self._before = now
            self._end += now
        if actuals is None:
            return None if now >= self._end else dict(self.rest)
        if self._base is None:
            self._base = actuals[POSITION]
        self._turn += min(now - self._before, _LONGEST_STEP_NS) / SECOND * self._wish.frequency
        self._before = now
        if self._turn >= 1:
            self._turn -= 1
            self._seen.append(self._worst)
            if self._worst > self._wish.by:
                self._base = actuals[POSITION]
            self._worst = 0.0
            if self.passed:
                return None
        if now >= self._end:
            return None
        angle = 2 * math.pi * self._turn
        target = self._base + self._wish.by / 2 * (1 - math.cos(angle))
        speed = self._wish.by / 2 * 2 * math.pi * self._wish.frequency * math.sin(angle)
        rpm = speed / self._increments * SECONDS_PER_MINUTE if self._wish.feed_forward else 0.0
        setpoints = self._loop.step(target, actuals, rpm)
        self._worst = max(self._worst, abs(self._loop.error))
        # Without DSC, XERR has no effect; it is only displayed.
        setpoints["XERR"] = round(self._loop.error)
        return {name: setpoints[name] for name in self.rest}
