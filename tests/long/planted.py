"""Defects planted in the gateway: how they are planted, and those of the power stage that the walk and the soak have to find."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

import pytest

from pdgw.gateway.axis import interlock, power_cells
from pdgw.gateway.axis.demand_report import PowerWish
from pdgw.gateway.axis.power_cells import CELLS, Cell
from pdgw.gateway.axis.power_states import Action, Drive, Phase
from pdgw.gateway.axis.power_table import ENABLES, ROWS, UNPOWERED, Row
from pdgw.gateway.base.reasons import Reason

Patch = pytest.MonkeyPatch
Plant = Callable[[Patch], None]
FOLLOW: Final = (Phase.FOLLOW,)
_EVERY: Final = tuple(Drive)


def replaced(place: object, name: str, value: object) -> Plant:
    """Another attribute."""
    return lambda patch: patch.setattr(place, name, value)


def wrapped(place: type, name: str, around: Callable[..., Any]) -> Plant:
    """A method replaced by ``around``, which gets the original method and the arguments."""
    method = getattr(place, name)
    return replaced(place, name, lambda *arguments, **named: around(method, *arguments, **named))


def row(
    phases: tuple[Phase, ...],
    drives: tuple[Drive, ...],
    wishes: tuple[PowerWish, ...],
    phase: Phase | None,
    action: Action,
) -> Plant:
    """A row before all others of the power table."""

    def plant(patch: Patch) -> None:
        wrong = Row(phases, drives, wishes, phase, action, Reason.NOT_OPERATING, "planted")
        patch.setattr(power_cells, "ROWS", (wrong, *ROWS))
        patch.setattr(interlock, "CELLS", power_cells._compile())

    return plant


def each_cell(change: Callable[[Cell], Cell]) -> Plant:
    """All cells of the power table."""
    return lambda patch: patch.setattr(interlock, "CELLS", tuple(map(change, CELLS)))


LOCKS: Final[Mapping[str, Plant]] = {
    "an ON without an OFF before it starts the drive": row(
        (Phase.LOCKED,), UNPOWERED, ENABLES, Phase.FOLLOW, Action.SHUTDOWN
    ),
    "OFF2 does not lock": row(FOLLOW, _EVERY, (PowerWish.COAST,), None, Action.DISABLE_VOLTAGE),
    "OFF3 does not lock": row(FOLLOW, _EVERY, (PowerWish.QUICK_STOP,), None, Action.QUICK_STOP),
}
"""Wrong rows that start a drive without a new OFF."""
