"""The status of many gateways as one table: a row for each cause, the worst first."""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from pdgw.gateway.reasons import Reason
from pdgw.tools.output.status_check import Health, findings


class Row(NamedTuple):
    """A cause and the gateways that have it."""

    health: Health
    cause: str
    """Name for programs: a reason as in the metric ``pdgw_object_blocked``, or no_answer, no_plc, bus_lost, fault."""
    text: str
    gateways: tuple[str, ...]


def rows(documents: Mapping[str, dict[str, Any] | None], errors: Mapping[str, str]) -> list[Row]:
    """The causes of all gateways. ``errors``: why a gateway has no document. A gateway without a problem is in no row."""
    found: dict[str, Row] = {}
    for name, document in documents.items():
        for health, cause, text in _causes(document, errors.get(name, "")):
            old = found.get(cause, Row(health, cause, text, ()))
            gateways = old.gateways if name in old.gateways else (*old.gateways, name)
            found[cause] = old._replace(health=max(old.health, health), gateways=gateways)
    return sorted(found.values(), key=lambda row: (-row.health, -len(row.gateways), row.cause))


def _causes(document: dict[str, Any] | None, error: str) -> Iterator[tuple[Health, str, str]]:
    if document is None:
        yield Health.UNKNOWN, "no_answer", f"no answer: {error}"
        return
    try:
        found = findings(document)
    except (KeyError, TypeError, IndexError) as problem:
        yield Health.UNKNOWN, "no_answer", f"no answer: the status has an unexpected format ({problem!r})"
        return
    for finding in found:
        reason = Reason.__members__.get(finding.cause.upper())
        text = finding.text if reason is None else f"{reason.value}. {reason.remedy[:1].upper()}{reason.remedy[1:]}."
        yield finding.health, finding.cause, text


def worst(table: Sequence[Row]) -> Health:
    """The exit status of the command."""
    return max((row.health for row in table), default=Health.OK)


def lines(table: Sequence[Row], names: Sequence[str], width: int = 80) -> Iterator[str]:
    """The table as text: a line with totals, then each cause with its gateways, folded at ``width`` columns."""
    states = dict.fromkeys(names, Health.OK)
    for row in table:
        for name in row.gateways:
            states[name] = max(states[name], row.health)
    counts = Counter(states.values())
    totals = ", ".join(f"{counts[health]} {health.name}" for health in Health if counts[health])
    yield f"{len(names)} gateways: {totals}"
    for row in table:
        yield ""
        yield f"{row.health.name:8} {len(row.gateways):4}  {row.cause}"
        for text in (row.text, ", ".join(row.gateways)):
            yield from textwrap.wrap(text, width, initial_indent=" " * 15, subsequent_indent=" " * 15)
