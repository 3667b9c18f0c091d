"""``pdgw status --check``: one line and an exit code in the format of monitoring systems (Nagios, Icinga, Zabbix)."""

from __future__ import annotations

from enum import IntEnum
from typing import Any, NamedTuple

from pdgw.gateway.reasons import AxisState, Reason
from pdgw.tools.output.status_text import cause_sentence

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
        if item["do_id"] not in stopped and any(fault["active"] for fault in item["faults"]):
            found.append(Finding(Health.WARNING, f"{item['label']}: {item['faults'][0]['text']}"))
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
