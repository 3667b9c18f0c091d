"""The causes why drive objects are not in operation: one line for each cause, however many objects it stops."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from itertools import groupby
from typing import Any, Final, NamedTuple, TypeVar

from pdgw.base.durations import MS, SECOND
from pdgw.gateway.base.finding_text import EACH_NODE, clock, evidence_text, finding_text, times_text
from pdgw.gateway.base.reasons import AxisState, Finding, Reason
from pdgw.gateway.base.step_text import remedy_text
from pdgw.gateway.objects.drive_object import DriveObject

_Item = TypeVar("_Item")
_ORDER: Final = tuple(reversed(AxisState))
"""Order of the states, the worst first."""
_OFFLINE: Final = (Reason.DRIVE_OFFLINE, Reason.ENCODER_OFFLINE)
_TEXTS: Final = 3
"""Texts, or times, of one cause in one line."""
_TOGETHER_NS: Final = SECOND
"""Nodes of a bus that were last heard so shortly after each other have one cause."""
_SHARED: Final = ("check what these nodes share: CAN cable, termination, bit rate and supply",)


class Stop(NamedTuple):
    """What keeps one drive object from operation."""

    item: DriveObject
    state: AxisState
    reason: Reason
    found: Finding

    @property
    def evidence(self) -> str:
        """Without times; of a node, as of each node."""
        return evidence_text(self.found._replace(node=EACH_NODE) if self.found.node else self.found)

    @property
    def when(self) -> str:
        """The begin, and how often; empty without a time."""
        if self.found.since_ns is None:
            return ""
        times = f", {self.found.times} times" if self.found.times > 1 else ""
        return clock(self.found.since_ns, self.item.network.loop) + times


def causes(items: Sequence[DriveObject]) -> list[dict[str, Any]]:
    """The causes in the states of drive objects that were shown, the worst first, of equal ones that of most objects."""
    stops = []
    for item in items:
        state, link = item.shown.state, item.shown.broken
        # One that is off as the PLC asks needs no action, unless a fault of it is not acknowledged.
        if link is not None and link.reason and link.found and (state is not AxisState.OFF or item.cause):
            stops.append(Stop(item, state, link.reason, link.found))
    groups: dict[object, list[Stop]] = {}
    together = _lost_together(stops, {(item.network.name, item.node_id) for item in items})
    for stop in stops:
        loss, own = together.get(stop.item.do_id), stop.found
        device = own.node and type(stop.item)  # a drive and an encoder are refused for different things
        key = loss or (stop.state, stop.reason, own.reason, own.by, own.number, own.code, own.remedy, device)
        groups.setdefault(key, []).append(stop._replace(found=loss or own))
    members = sorted(groups.values(), key=lambda stops: (_ORDER.index(stops[0].state), -len(stops)))
    return [_cause(stops) for stops in members]


def _lost_together(stops: Sequence[Stop], nodes: Collection[tuple[str, int]]) -> dict[int, Finding]:
    """What explains the loss of several nodes of a bus at one moment, by the DO-ID of their objects. ``nodes``: bus and ID of
    all."""
    offline = [stop.item for stop in stops if stop.reason in _OFFLINE]
    offline.sort(key=lambda item: (item.network.name, -item.client.received_ns))
    found: dict[int, Finding] = {}
    while offline:
        bus, last_ns = offline[0].network.name, offline[0].client.received_ns
        members = [
            item
            for item in offline
            if item.network.name == bus
            and item.client.received_ns + _TOGETHER_NS >= last_ns
            and (item.client.received_ns > 0) is (last_ns > 0)
        ]
        del offline[: len(members)]
        lost = {item.node_id for item in members}
        if len(lost) > 1:
            known = sum(name == bus for name, _ in nodes)
            apart = (last_ns - members[-1].client.received_ns) / MS
            when = f"lost within {apart:.0f} ms" if last_ns else "have not answered since the start"
            text = f"{len(lost)} of {known} nodes on bus {bus} {when}: CAN cable or supply"
            loss = Finding(Reason.DRIVE_OFFLINE, text, _SHARED)
            found |= {item.do_id: loss for item in members}
    return found


def _text(stops: Sequence[Stop]) -> str:
    """The text of all: their evidence, since when, how often, and what follows; or that of each group, in their order."""
    texts = {finding_text(stop.found, stop.item.network.loop) for stop in stops}
    if len(texts) == 1:
        return texts.pop()
    shared = _grouped(stops, lambda stop: stop.evidence)
    if len(shared) == 1:
        follows = {stop.found.more for stop in stops}
        return stops[0].evidence + _since(stops) + (follows.pop() if len(follows) == 1 else "") + _recalled(stops)
    lines = [f"{_who(found)}: {_text(found)}" for found in shared.values()]
    more = len(lines) - _TEXTS
    return "; ".join(lines[:_TEXTS]) + (f"; and {more} more of the kind" if more > 0 else "")


def _since(stops: Sequence[Stop]) -> str:
    """Since when, and how often, for each of them where they differ; empty if one of them has no time."""
    groups = _grouped(stops, lambda stop: stop.when)
    if "" in groups:
        return ""
    if len(groups) == 1:
        return times_text(stops[0].found, stops[0].item.network.loop)
    if len(groups) <= _TEXTS:
        return f", since {', '.join(f'{when} ({_who(found)})' for when, found in groups.items())}"
    first, *_, last = sorted(stops, key=lambda stop: stop.found.period)
    return f", since {first.when} to {last.when}"


def _recalled(stops: Sequence[Stop]) -> str:
    """After a start: how the last gateway ended, and what had stopped each of them then."""
    before = _grouped(stops, lambda stop: stop.found.before)
    if not stops[0].found.ended:
        return ""
    texts = [f"{_who(found)}: {text}" for text, found in before.items() if text]
    return f"; {stops[0].found.ended}" + (f"; before: {'; '.join(texts)}" if texts else "")


def _who(stops: Sequence[Stop]) -> str:
    return who([stop.item for stop in stops])


def _cause(stops: Sequence[Stop]) -> dict[str, Any]:
    first = stops[0]
    return {
        "state": first.state.value,
        "state_id": first.state.name,
        "reason": _text(stops),
        "reason_id": first.reason.name,
        "remedy": remedy_text(first.found.remedy),
        "who": _who(stops),
        "objects": [stop.item.do_id for stop in stops],
    }


def who(items: Sequence[DriveObject]) -> str:
    """``axis 3 "slide"``, or ``axes 1-4, 7; encoder 9``."""
    kinds = _grouped(items, lambda item: item.kind)
    plurals = {"axis": "axes", "encoder": "encoders"}
    return "; ".join(
        found[0].label if len(found) == 1 else f"{plurals[kind]} {', '.join(_ranges([item.do_id for item in found]))}"
        for kind, found in kinds.items()
    )


def _grouped(items: Sequence[_Item], key: Callable[[_Item], str]) -> dict[str, list[_Item]]:
    """The items by what they have in common, in their order."""
    groups: dict[str, list[_Item]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups


def _ranges(numbers: Sequence[int]) -> Iterator[str]:
    for _, run in groupby(enumerate(sorted(numbers)), lambda pair: pair[1] - pair[0]):
        found = [number for _, number in run]
        yield str(found[0]) if len(found) == 1 else f"{found[0]}-{found[-1]}"
