"""The status of a gateway as text: each cause, then one line for each drive object, folded to the terminal's width.

``pdgw status --check``: one line and an exit code in the format of monitoring systems (Nagios, Icinga, Zabbix)."""

from __future__ import annotations

import textwrap
from bisect import bisect_left
from collections.abc import Iterator
from datetime import datetime
from enum import IntEnum
from itertools import accumulate
from pathlib import Path
from typing import Any, NamedTuple

from pdgw.base.durations import MS_PER_SECOND
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.reasons import AxisState, Reason

_BAD = (AxisState.FAULT.name, AxisState.NOT_ON_THE_BUS.name)
_CONNECTED = ("", *(reason.name for reason in (Reason.PLC_STOP, Reason.PLC_BAD, Reason.OTHER_SENDER)))
"""Findings of a link whose PLC is connected. With another one the PLC is lost repeatedly."""


class Health(IntEnum):
    """Exit codes of a check."""

    OK = 0
    WARNING = 1
    """An axis starts, waits or is being stopped, or a warning is active."""
    CRITICAL = 2
    """No PLC, a bus lost, a drive or encoder in fault or not on its bus."""
    UNKNOWN = 3
    """No gateway answers."""


class Finding(NamedTuple):
    """A problem and its severity."""

    health: Health
    text: str


def findings(document: dict[str, Any]) -> list[Finding]:
    """All problems in a status document, the worst first."""
    found: list[Finding] = []
    plc = document["plc"]
    if not plc["connected"] or plc["refused_id"] not in _CONNECTED:
        found.append(Finding(Health.CRITICAL, "no PLC"))
    if plc["refused_id"] == Reason.OTHER_SENDER.name:
        found.append(Finding(Health.WARNING, plc["refused"]))
    found += [Finding(Health.CRITICAL, f"bus {bus['name']} lost") for bus in document["buses"] if not bus["healthy"]]
    stopped: set[int] = set()
    for cause in document["causes"]:
        health = Health.CRITICAL if cause["state_id"] in _BAD else Health.WARNING
        found.append(Finding(health, cause_sentence(cause)))
        stopped.update(cause["objects"])
    for item in (*document["axes"], *document["encoders"]):
        if item["do_id"] in stopped:
            continue
        texts = [fault["text"] for fault in item["faults"] if fault["active"]] or [item["warning"]]
        found += [Finding(Health.WARNING, f"{item['label']}: {text}") for text in texts if text]
    return sorted(found, key=lambda finding: -finding.health)


def check_line(document: dict[str, Any]) -> tuple[Health, str]:
    """The worst severity, and the line with the performance data after ``|``."""
    found = findings(document)
    health = found[0].health if found else Health.OK
    items = [*document["axes"], *document["encoders"]]
    obeying = sum(item["state_id"] == AxisState.OBEYS.name for item in items)
    text = "; ".join(finding.text for finding in found) or f"PLC connected, {obeying} of {len(items)} in operation"
    figures = f"objects={len(items)} obeying={obeying} findings={len(found)} uptime={document['uptime_s']:.0f}s"
    return health, f"{health.name} - {document['name']}: {text} | {figures}".replace("\n", " ")


_USUAL = {"accepted", "answered", "sent", "received", "syncs", "cycles", "generation", "no_tick", "after_loss"}
"""Counters that also rise in normal operation. Each connect, for example, begins with frames without a tick."""
_DAY_S = 86_400


def duration(seconds: float) -> str:
    """Format a duration: ``3 s``, ``12 min 5 s``, ``2 h 3 min``, ``4 d 1 h``."""
    whole = int(seconds)
    units = (("d", whole // _DAY_S), ("h", whole // 3600 % 24), ("min", whole // 60 % 60), ("s", whole % 60))
    shown = [(name, value) for name, value in units if value]
    if not shown:
        return "0 s"
    first = units.index(shown[0])
    return " ".join(f"{value} {name}" for name, value in units[first : first + 2] if value)


def _age(age_ms: float) -> str:
    return f"{age_ms:g} ms" if age_ms < MS_PER_SECOND else duration(age_ms / MS_PER_SECOND)


def cause_sentence(cause: dict[str, Any]) -> str:
    """One sentence: which axes are not in operation, why, and the remedy."""
    remedy = cause["remedy"]
    return f"{cause['who']} {cause['state']}: {cause['reason']}. {remedy[:1].upper()}{remedy[1:]}."


def object_lines(document: dict[str, Any], do_id: int, width: int = 80) -> Iterator[str]:
    """All details of one drive object; GatewayError when it does not exist."""
    for kind, items in (("axis", document["axes"]), ("encoder", document["encoders"])):
        for item in items:
            if item["do_id"] == do_id:
                yield from _object(item, kind, width)
                node = f"node {item['node_id']} on {item['bus']}"
                own = [
                    counter
                    for counter in document["counters"]
                    if counter["part"] in (node, f"parameters of DO {do_id}")
                ]
                yield from _counters(own, width, everything=True)
                return
    known = ", ".join(str(item["do_id"]) for item in (*document["axes"], *document["encoders"]))
    raise GatewayError(f"axis {do_id}: unknown drive object, allowed: {known}")


def status_lines(document: dict[str, Any], width: int = 80, *, counters: bool = False) -> Iterator[str]:
    """The overview: each cause once, each drive object in one line. ``counters``: show all, not only the abnormal ones."""
    plc = document["plc"]
    peer = (
        f"{plc['peer'][0]}:{plc['peer'][1]}"
        if plc["peer"]
        else ("no controller" if plc.get("station") else "no sender yet")
    )
    up, at = duration(document["uptime_s"]), _time_of_day(document["time"])
    yield f"{document['name']}: pdgw {document['version']}, up {up}, at {at}"
    age = "" if plc["heard_age_ms"] is None else f", the last {_age(plc['heard_age_ms'])} ago"
    connected = "connected" if plc["connected"] else "not connected"
    yield f"PLC {connected} ({peer}), {plc['frames']['accepted']} frames{age}"
    if plc.get("station"):
        yield from _folded(_station(plc["station"]), width, 2, "")
    if plc.get("age_limit_ms"):
        yield from _folded(_ages(document["age_times"], plc["age_limit_ms"]), width, 2, "")
    if plc["refused"]:
        yield from _folded(plc["refused"], width, 5, "  -> ")
    if document.get("file"):
        yield from _configuration(document["file"], document["file_modified"], width)
    if document.get("store"):
        yield from _folded(f"parameters are stored in {document['store']}", width, 4, "")
    for note in document["notes"]:
        yield from _folded(note, width, 5, "  -> ")
    for bus in document["buses"]:
        yield f"bus {bus['name']}: {'healthy' if bus['healthy'] else 'LOST'}{bus.get('outage') and ': ' + bus['outage']}"
        if bus.get("sync"):
            yield from _sync(bus["sync"], width)
    yield ""
    for cause in document["causes"]:
        yield from _folded(cause_sentence(cause), width, 3, "-> ")
    for item in (*document["axes"], *document["encoders"]):
        yield from _folded(_row(item), width, 4, "")
        for total in item.get("totals", ()):
            if total["count"] > 1:
                yield from _folded(_total(total, document["time"]), width, 4, "  ")
    yield from _counters(document["counters"], width, everything=counters)


def _configuration(file: str, modified: float, width: int) -> Iterator[str]:
    """The file that runs, and whether it is another one by now."""
    yield from _folded(f"configuration {file}", width, 4, "")
    try:
        is_other = Path(file).stat().st_mtime != modified
    except OSError as error:
        is_other = isinstance(error, FileNotFoundError)
    if is_other:
        text = "changed or removed since the start: the gateway runs what it read then; run pdgw config check, then restart it"
        yield from _folded(text, width, 5, "  -> ")


def _row(item: dict[str, Any]) -> str:
    """One drive object in one line."""
    parts = [f"node {item['node_id']} {item['drive']}", f"telegram {item['telegram']}"]
    if item.get("activity"):
        parts.append(item["activity"])
    last = item.get("last")
    if last is None:
        parts += _values(item, item)
    elif known := _values(last, item):
        parts.append(f"last {', '.join(known)}, {_age(item['heard_age_ms'])} ago")
    active = item["cause"]
    if active is not None and item["state_id"] != AxisState.FAULT.name:
        parts.append(f"fault {active['number']} not acknowledged")
    if item["warning"]:
        parts.append(item["warning"])
    if item["state_id"] == AxisState.OBEYS.name:
        parts += [f"{item['name']} not active" for item in item.get("protections", ()) if item["active"] is False]
    return f"{item['label']}: {item['state']} ({', '.join(parts)})"


def _total(total: dict[str, Any], now: str) -> str:
    """A fault that has come again, whatever was acknowledged meanwhile."""
    first, last = (
        _time_of_day(text) if text[:10] == now[:10] else _day(text) for text in (total["first"], total["last"])
    )
    return f"{total['name']}: {total['count']} times since {first}, last {last}"


def _values(values: dict[str, Any], item: dict[str, Any]) -> list[str]:
    """Speed and position, as far as they are known."""
    parts = []
    if values["speed_text"]:
        parts.append(values["speed_text"])
    if values["position"] is not None:
        parts.append(f"position {values['position']} {item.get('position_unit') or ''}".rstrip())
    return parts


def _ages(times: dict[str, Any], limit_ms: float) -> str:
    """The age of the PLC's frames (round trip): shares by class, the greatest, and the limit."""
    total = sum(times["counts"])
    if not total:
        return f"age of frames: limit {limit_ms:g} ms"
    shares = ", ".join(f"p{share} {_below(times, share / 100)}" for share in (50, 99))
    return f"age of frames: {shares}, max {times['max_s'] * MS_PER_SECOND:.1f} ms, limit {limit_ms:g} ms"


def _below(times: dict[str, Any], share: float) -> str:
    """The end of the class below which this share of all values is."""
    counts, ends = times["counts"], times["bounds_s"]
    place = bisect_left(list(accumulate(counts)), sum(counts) * share)
    return (
        f"at most {ends[place] * MS_PER_SECOND:g} ms" if place < len(ends) else f"above {ends[-1] * MS_PER_SECOND:g} ms"
    )


def _station(station: dict[str, Any]) -> str:
    """Describe the PROFINET device: name, address and connected controllers."""
    parts = [f"station {station['name'] or 'without a name'}", f"IP {station['ip']}", station["mac"]]
    if not station["link_up"]:
        parts.append("cable off")
    if station["controller"]:
        cycle = "" if station["cycle_ms"] is None else f", cycle {station['cycle_ms']:g} ms"
        parts.append(f"controller {station['controller']}: {station['relationship']}{cycle}")
    else:
        parts.append("no relationship")
    if station["flashing"]:
        parts.append("flash signal")
    return ", ".join(parts)


def _time_of_day(text: str) -> str:
    return datetime.fromisoformat(text).strftime("%H:%M:%S")


def _day(text: str) -> str:
    return datetime.fromisoformat(text).strftime("%Y-%m-%d %H:%M:%S")


def _folded(text: str, width: int, indent: int, first: str | None = None) -> Iterator[str]:
    head = " " * indent if first is None else first
    yield from textwrap.wrap(
        text, width, initial_indent=head, subsequent_indent=" " * indent, break_on_hyphens=False
    ) or [head]


def _counters(items: list[dict[str, Any]], width: int, *, everything: bool) -> Iterator[str]:
    if everything:
        for item in items:
            text = f"{item['part']} {item['name']}: {item['value']} {item['unit']} ({item['meaning']})"
            yield from _folded(text, width, 4, "  ")
        return
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for item in items:
        if item["value"] and item["name"] not in _USUAL:
            groups.setdefault((item["name"], item["meaning"]), []).append(item)
    if groups:
        yield "abnormal counters:"
    for (name, meaning), members in groups.items():
        part = members[0]["part"] if len(members) == 1 else f"{len(members)} parts,"
        text = f"{part} {name}: {sum(item['value'] for item in members)} {members[0]['unit']} ({meaning})"
        yield from _folded(text, width, 4, "  ")


def _sync(sync: dict[str, Any], width: int) -> Iterator[str]:
    jitter = f"jitter p99 {sync['jitter_p99_us']:g} us, worst {sync['jitter_worst_us']:g} us"
    yield from _folded(f"SYNC every {sync['period_ms']:g} ms, {jitter}", width, 4, "  ")
    for item in sync["axes"]:
        text = f"axis {item['do_id']} dead time p99 {item['dead_time_p99_ms']:g} ms, worst {item['dead_time_worst_ms']:g} ms"
        if item["highest_gain"] is not None:
            text += f"; for {item['dead_time_calculated_ms']:g} ms KPC is at most {item['highest_gain']:.1f} 1/s"
        yield from _folded(text, width, 4, "  ")


def _object(item: dict[str, Any], kind: str, width: int) -> Iterator[str]:
    age = item["heard_age_ms"]
    heard = "" if age is None else f", last heard {age:g} ms ago"
    head = f"{item['label']}, node {item['node_id']} {item['drive']}{heard}, telegram {item['telegram']}"
    shown = item["drive_state"] if kind == "axis" else f"sensor {item['sensor_state']}"
    yield from _folded(f"{head} ({shown})", width, 4, "")
    yield from _folded(item["sentence"], width, 5, "  -> ")
    for link in item["chain"]:
        if link["ok"] is False and link["evidence"] != item["reason"]:
            yield from _folded(f"also missing: {link['text']} ({link['evidence']})", width, 5, "     ")
    for note in item.get("notes", ()):
        yield from _folded(f"note: {note}", width, 5, "     ")
    for title, values in (("from PLC", item["setpoint_texts"]), ("to PLC", item["actual_texts"])):
        parts = [f"{name} {text}" for name, text in values.items()]
        yield from _folded(",  ".join(parts) or "nothing valid", width, 12, f"  {title:<9} ")
    if not item["iops_good"]:
        yield "  its values are marked as bad (IOPS)"
    protections = [f"{protection['name']}: {protection['text']}" for protection in item.get("protections", ())]
    confirmed = [item["units_witnessed"]] if item.get("units_witnessed") else []
    left = item.get("left_to_the_drive", ())
    for line in (*item.get("scaling", ()), *confirmed, *item.get("pdos", ()), *left, *protections):
        yield from _folded(line, width, 4, "  ")
    yield from _faults(item, width)
    older = item["fault_count"] - len(item["faults"])
    if older > 0:
        yield f"  and {older} older {'one' if older == 1 else 'ones'} (--faults)"


def fault_lines(item: dict[str, Any], width: int) -> Iterator[str]:
    """The faults of one drive object after a line with its name; nothing without faults."""
    if item["faults"]:
        yield f"{item['label']}:"
        yield from _faults(item, width)


def _faults(item: dict[str, Any], width: int) -> Iterator[str]:
    for fault in item["faults"]:
        what = ("active " if fault["active"] else "") + ("warning" if fault["is_warning"] else "fault")
        text = f"{what} {fault['number']} at {_time_of_day(fault['time'])}, {duration(fault['age_s'])} ago: {fault['text']}"
        yield from _folded(text, width, 4, "  ")
