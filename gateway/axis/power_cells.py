"""The compiled power table: a cell for each phase, drive state and request, with everything that follows from its row."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from pdgw.gateway.axis.demand_report import Flag, PowerWish
from pdgw.gateway.axis.orders import Order
from pdgw.gateway.axis.power_states import CONTROLWORDS, Action, Drive, Phase
from pdgw.gateway.axis.power_table import (
    COASTS,
    IN_OPERATION,
    NO_PLC,
    OFF3S,
    ORDER_ROWS,
    ROWS,
    SHOWS_OPERATION,
)
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.base.reasons import Reason


@dataclass(frozen=True, slots=True)
class Cell:
    """One entry of the compiled table; ``row`` is its number in ``ROWS``.

    ``operating``: operation is commanded, and shown as commanded. ``shown``: a Statusword that says Operation enabled is repeated
    to the PLC, also until Disable Operation has acted. ``visible``: the drive's own bits that are shown as they are; "no OFF2"
    and "no OFF3" are hidden while one is in force, whatever the drive says. ``order``: what the drive must do in time.
    ``fault``: whose consequence a stop is; None of one that the PLC requests.
    """

    row: int
    phase: Phase
    action: Action
    controlword: int
    reason: Reason | None
    operating: bool
    shown: bool
    visible: int
    order: Order
    fault: int | None


def _order(drive: Drive, action: Action, wish: PowerWish) -> Order:
    return next(
        order
        for drives, actions, wishes, order in ORDER_ROWS
        if drive in drives and action in actions and wish in wishes
    )


def _visible(phase: Phase, wish: PowerWish) -> int:
    visible = Flag.OF_THE_DRIVE
    if wish in COASTS:
        visible &= ~Flag.NO_COAST_STOP
    if wish in OFF3S or phase is Phase.QUICK_STOP:
        visible &= ~Flag.NO_QUICK_STOP
    return visible


def _compile() -> tuple[Cell, ...]:
    cells = []
    for phase in Phase:
        for drive in Drive:
            for wish in PowerWish:
                for number, row in enumerate(ROWS):
                    if phase in row.phases and drive in row.drives and wish in row.wishes:
                        after = phase if row.phase is None else row.phase
                        reason = row.reason
                        if reason in _PLC_ASKED and wish in NO_PLC:
                            reason = Reason.PLC_LOST
                        operating = row.action in (Action.ENABLE_OPERATION, Action.PASS) and drive in IN_OPERATION
                        shown = operating or (
                            row.action in (Action.SWITCH_ON, Action.SHUTDOWN) and drive in SHOWS_OPERATION
                        )
                        word = CONTROLWORDS[row.action]
                        visible, order = _visible(after, wish), _order(drive, row.action, wish)
                        fault = row.fault or _FAULTS.get(wish)
                        cells.append(
                            Cell(number, after, row.action, word, reason, operating, shown, visible, order, fault)
                        )
                        break
                else:
                    raise AssertionError(f"power table: no row for {phase.name}, {drive.name}, {wish.name}")
    return tuple(cells)


_PLC_ASKED: Final = (Reason.NEEDS_OFF, Reason.RAMP_STOP, Reason.QUICK_STOP, Reason.COAST_STOP, Reason.NOT_OPERATING)
"""Reasons that mean the PLC's own doing; without one the reason is that it is lost."""
_FAULTS: Final = dict.fromkeys(NO_PLC, FaultNumber.PLC_LOST) | dict.fromkeys(
    (PowerWish.STOP, PowerWish.HOLD), FaultNumber.CONTROL_LOST
)
"""Stops by what the PLC lacks, and not by the drive."""
DRIVES: Final = len(Drive)
WISHES: Final = len(PowerWish)
CELLS: Final = _compile()
"""Cells by ``(phase * DRIVES + drive) * WISHES + wish``."""


def cell(phase: Phase, drive: Drive, wish: PowerWish) -> Cell:
    """The cell of the table."""
    return CELLS[(phase * DRIVES + drive) * WISHES + wish]
