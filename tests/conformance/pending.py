"""Habits with which the gateway does not do yet what the table says, with the telegram. Without a row here, a test demands it."""

from __future__ import annotations

import pytest

_ITSELF = "a drive that enters operation by itself is stopped without a report"

PENDING: dict[tuple[str, int], str] = {
    ("enables-itself", 1): _ITSELF,
}
"""Why the test of a habit fails."""


def pending(name: str, number: int, error: type[Exception] = AssertionError) -> list[pytest.MarkDecorator]:
    """The marks of a test of a habit with a telegram that fails with this error."""
    why = PENDING.get((name, number))
    return [] if why is None else [pytest.mark.xfail(strict=True, reason=why, raises=error)]
