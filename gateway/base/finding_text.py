"""The one text of a finding: status, page, log, events and faults have it from its fields. Nothing takes it apart again."""

from __future__ import annotations

from datetime import datetime
from typing import TYPE_CHECKING, Final

from pdgw.base.durations import SECOND
from pdgw.gateway.base.reasons import REFUSED_ORDERS, Finding, Reason
from pdgw.gateway.base.step_text import remedy_text

if TYPE_CHECKING:  # the command line has no loop
    from pdgw.ds301.loop.loop import Loop

DAY_NS: Final = 86_400 * SECOND
EACH_NODE: Final = -1
"""``Finding.node`` of several objects that have the same finding for their own nodes."""
_BEGINS: Final = dict.fromkeys(REFUSED_ORDERS, " (at {})") | {
    Reason.HOME_LOST: " at {}",
    Reason.LAGS: " since {}",
    Reason.NO_RELATIONSHIP: " since {}",
}
"""How the text has the begin; else ``, since``."""


def wall_time(time_ns: int, loop: Loop) -> float:
    """Seconds since 1970 of a monotonic time."""
    return loop.wall() - (loop.now() - time_ns) / SECOND


def clock(time_ns: int, loop: Loop, *, dated: bool = False) -> str:
    """The time of day of a monotonic time; with its date if ``dated``, or when the same time of day has come again."""
    shown = datetime.fromtimestamp(wall_time(time_ns, loop))
    return f"{shown:%H:%M:%S on %Y-%m-%d}" if dated or loop.now() - time_ns >= DAY_NS else f"{shown:%H:%M:%S}"


def with_count(text: str, count: int, duration_ns: int) -> str:
    """A text that is repeated, with its number and the time since the first one."""
    return text if count == 1 else f"{text} ({count} times in {max(1, duration_ns // SECOND)} s)"


def evidence_text(found: Finding) -> str:
    """What is found, without its time and what follows that."""
    node = "each node " if found.node == EACH_NODE else found.node and f"node {found.node} "
    return f"{node or ''}{found.evidence}"


def finding_text(found: Finding, loop: Loop | None, *, dated: bool = False) -> str:
    """What is found, since when, how often, and what belongs to it. Without a loop: without times, for what has its own time.

    ``dated``: for a reader of another day.
    """
    when = "" if loop is None else times_text(found, loop, dated=dated)
    ended = f"; {found.ended}" if found.ended else ""
    before = f"; before: {found.before}" if found.before else ""
    return f"{evidence_text(found)}{when}{found.more}{ended}{before}"


def times_text(found: Finding, loop: Loop, *, dated: bool = False) -> str:
    """Since when, and how often. ``dated``: for a reader of another day."""
    if found.since_ns is None:
        return ""
    begin = clock(found.since_ns, loop, dated=dated)
    if found.until_ns is not None:
        return f" from {begin} to {clock(found.until_ns, loop, dated=dated)}"
    times = f" ({found.times} times)" if found.times > 1 else ""
    return _BEGINS.get(found.reason, ", since {}").format(begin) + times


def finding_line(found: Finding, loop: Loop | None = None) -> str:
    """What is found, and what to do, in one line."""
    return f"{finding_text(found, loop)}; {remedy_text(found.remedy)}"
