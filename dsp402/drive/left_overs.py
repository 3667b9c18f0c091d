"""Values of another master in the objects that act beside a setpoint, corrected before ON. The table is ``dsp402.acting``.

In the node's task: an object is written only if its value is wrong, while the drive has no power. Source: docs/devices.md
"What acts in a mode".
"""

from __future__ import annotations

from collections.abc import Callable, Collection

from pdgw.ds301.configuration import SdoStep
from pdgw.ds301.node.configuring import ConfiguringAccess
from pdgw.ds301.node.node import Notice
from pdgw.dsp402.acting import Acting, Found, Treatment
from pdgw.dsp402.drive_type import Dsp402Error
from pdgw.dsp402.objects import STATUSWORD
from pdgw.dsp402.states import State, state_of

OFF = (State.NOT_READY_TO_SWITCH_ON, State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, State.FAULT)
"""States of a drive that has no power, and gets none without two commands."""


class LeftOvers:
    """Corrects them in one drive. ``notify`` is called with an event of the node and its text."""

    def __init__(self, sdo: ConfiguringAccess, notify: Callable[[Notice, str], None]) -> None:
        self._sdo = sdo
        self._notify = notify
        self.waits = False
        """A value is corrected when the drive has no power."""

    def correct(self, rows: Collection[Acting], found: Found) -> str:
        """Set the bits that are wrong in ``found``, also there. Return why the drive must not be operated; empty: it may.

        An object that cannot be read is set to 0 if the whole object has to be 0.
        """
        self.waits = False
        refusals = []
        for row in rows:
            if row.address not in found or ((value := found[row.address]) is not None and row.fits(value)):
                continue
            shown = str(row.entry) if value is None else f"{row.entry} = {value}"
            is_whole, is_required = row.treatment is Treatment.ZERO, row.treatment is not Treatment.COMMANDED
            refusal = "it cannot be read now" if value is None and not is_whole else self._set(row, value or 0, found)
            if refusal and is_required and value is not None:
                refusals.append(f"{shown}: {row.why}; {refusal}")
            elif refusal or is_required:
                self._notify(Notice.PROGRESS, f"{shown}: {row.why}; {refusal or f'it is {found[row.address]} now'}")
        return "; ".join(refusals)

    def _set(self, row: Acting, value: int, found: Found) -> str:
        """Write the right bits. Return why not; empty: done."""
        right, entry = row.corrected(value), row.entry
        if state_of(self._sdo.read_number(*STATUSWORD)) not in OFF:
            self.waits = True
            return f"it is set to {right} when the drive has no power (OFF2)"
        try:
            self._sdo.do(SdoStep(*entry.address, entry.type, right, entry.name))
        except Dsp402Error as error:
            return str(error)
        found[entry.address] = right
        return ""
