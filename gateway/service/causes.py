"""The causes why drive objects are not in operation: one line for each cause, however many objects it stops."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from itertools import groupby
from math import inf
from typing import Any, Final

from pdgw.gateway.base.reasons import AxisState, Reason
from pdgw.gateway.objects.enable_status import untimed

_OBEYS: Final = AxisState.OBEYS.name
_FINE: Final = (_OBEYS, AxisState.OFF.name)
"""States that need no action."""
_ORDER: Final = tuple(state.name for state in reversed(AxisState))
"""Order of the states, the worst first."""
_OFFLINE: Final = (Reason.DRIVE_OFFLINE.name, Reason.ENCODER_OFFLINE.name)
_NUMBER: Final = re.compile(r"\d+")
_TEXTS: Final = 3
"""Texts that differ in their numbers only, in one line."""
_TOGETHER_MS: Final = 1000.0
"""Nodes of a bus that were last heard so shortly after each other have one cause."""
_SHARED: Final = "check what these nodes share: CAN cable, termination, bit rate and supply"


def causes(items: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The causes among the statuses of drive objects, the worst first, of equal ones that of most objects."""
    groups: dict[object, list[dict[str, Any]]] = {}
    together = _lost_together(items)
    for item in items:
        if (text := together.get(item["do_id"])) is not None:
            groups.setdefault(text, []).append(item | {"reason": text, "remedy": _SHARED})
        elif item["state_id"] not in _FINE or (
            item["reason_id"] and (item["state_id"] == _OBEYS or item["cause"] is not None)
        ):
            groups.setdefault(_key(item), []).append(item)
    found = [_cause(members) for members in groups.values()]
    return sorted(found, key=lambda cause: (_ORDER.index(cause["state_id"]), -len(cause["objects"])))


def _lost_together(items: Sequence[dict[str, Any]]) -> dict[int, str]:
    """What explains the loss of several nodes of a bus at one moment, by the DO-ID of their objects."""
    offline = [(item["bus"], item["heard_age_ms"] or inf, item) for item in items if item["reason_id"] in _OFFLINE]
    offline.sort(key=lambda loss: loss[:2])
    found: dict[int, str] = {}
    while offline:
        bus, first, _ = offline[0]
        members = [loss for loss in offline if loss[0] == bus and not loss[1] - first > _TOGETHER_MS]
        del offline[: len(members)]
        lost = {item["node_id"] for _, _, item in members}
        if len(lost) > 1:
            known = {item["node_id"] for item in items if item["bus"] == bus}
            when = (
                f"lost within {members[-1][1] - first:.0f} ms" if first < inf else "have not answered since the start"
            )
            text = f"{len(lost)} of {len(known)} nodes on bus {bus} {when}: CAN cable or supply"
            found |= {item["do_id"]: text for _, _, item in members}
    return found


def _key(item: dict[str, Any]) -> tuple[str, str, str, str]:
    """Objects with the same reason, evidence and remedy, whatever the numbers, are one line."""
    text = untimed(item["reason"])
    return item["state_id"], item["reason_id"], _NUMBER.sub("", text), _NUMBER.sub("", item["remedy"])


def _text(members: list[dict[str, Any]]) -> str:
    """The evidence of all, or that of each group of them, in their order."""
    if len({item["reason"] for item in members}) == 1:
        return str(members[0]["reason"])
    shared: dict[str, list[dict[str, Any]]] = {}
    for item in members:
        own = untimed(item["reason"]).replace(f"node {item['node_id']} ", "each node ")
        shared.setdefault(own.replace(f"node {item['node_id']}:", "each node:"), []).append(item)
    if len(shared) == 1:
        (text,) = shared
        return text + _since(members) + _recalled(members)
    more = len(shared) - _TEXTS
    texts = [f"{_who(found)}: {text}{_since(found)}" for text, found in shared.items()][:_TEXTS]
    return "; ".join(texts) + (f"; and {more} more of the kind" if more > 0 else "")


def _since(members: list[dict[str, Any]]) -> str:
    """Since when, and how often, for each of them where they differ; empty if their line has no time."""
    groups: dict[str, list[dict[str, Any]]] = {}
    for item in members:
        groups.setdefault(_when(item), []).append(item)
    if "" in groups:
        return ""
    if len(groups) == 1:
        return f", since {next(iter(groups))}"
    if len(groups) <= _TEXTS:
        return f", since {', '.join(f'{when} ({_who(found)})' for when, found in groups.items())}"
    return f", since {min(groups)} to {max(groups)}"


def _when(item: dict[str, Any]) -> str:
    """The time of the origin of a latch or of a fault, and how often it came; empty if the line of the object has none."""
    origin, cause = item["origin"], item["cause"]
    if untimed(item["reason"]) == item["reason"]:
        return ""
    if item["reason_id"] == Reason.NEEDS_OFF.name and origin is not None:
        count = f", {origin['count']} times" if origin["count"] > 1 else ""
        return time_of_day(origin["first"]) + count
    return "" if cause is None else time_of_day(cause["time"])


def _recalled(members: list[dict[str, Any]]) -> str:
    """After a start: how the last gateway ended, and what had stopped each of them then."""
    origins = [item["origin"] for item in members]
    if any(origin is None or not origin["ended"] for origin in origins):
        return ""
    before: dict[str, list[dict[str, Any]]] = {}
    for item, origin in zip(members, origins, strict=True):
        if origin["before"]:
            before.setdefault(origin["before"], []).append(item)
    texts = [f"{_who(found)}: {text}" for text, found in before.items()]
    return f"; {origins[0]['ended']}" + (f"; before: {'; '.join(texts)}" if texts else "")


def _who(members: list[dict[str, Any]]) -> str:
    return who({item["do_id"]: item["label"] for item in members})


def time_of_day(text: str) -> str:
    """Hours, minutes and seconds of a time in ISO text."""
    return datetime.fromisoformat(text).strftime("%H:%M:%S")


def _cause(members: list[dict[str, Any]]) -> dict[str, Any]:
    first = members[0]
    return {
        "state": first["state"],
        "state_id": first["state_id"],
        "reason": _text(members),
        "reason_id": first["reason_id"],
        "remedy": first["remedy"],
        "who": _who(members),
        "objects": [item["do_id"] for item in members],
    }


def who(labels: Mapping[int, str]) -> str:
    """``axis 3 "slide"``, or ``axes 1-4, 7; encoder 9``; ``labels`` by DO-ID."""
    kinds: dict[str, list[int]] = {}
    for do_id, label in labels.items():
        kinds.setdefault(label.partition(" ")[0], []).append(do_id)
    plurals = {"axis": "axes", "encoder": "encoders"}
    return "; ".join(
        labels[found[0]] if len(found) == 1 else f"{plurals[kind]} {', '.join(_ranges(found))}"
        for kind, found in kinds.items()
    )


def _ranges(numbers: Sequence[int]) -> Iterator[str]:
    for _, run in groupby(enumerate(sorted(numbers)), lambda pair: pair[1] - pair[0]):
        found = [number for _, number in run]
        yield str(found[0]) if len(found) == 1 else f"{found[0]}-{found[-1]}"
