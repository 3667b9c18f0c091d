"""The mode of operation of a drive: written to 6060h and checked in 6061h, which some drives show in operation only."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.configuration import SdoStep
from pdgw.ds301.node.configuring import ConfiguringAccess
from pdgw.ds301.node.node import Notice
from pdgw.ds301.node.operation import Operation, Part
from pdgw.ds301.node.plan import PdoPlan
from pdgw.ds301.objects import CanType
from pdgw.dsp402.drive.images import DriveFeedback
from pdgw.dsp402.drive_type import Dsp402Error
from pdgw.dsp402.modes import MODE_CONFIRM_NS, MODE_NAMES, Mode
from pdgw.dsp402.objects import MODE, MODE_DISPLAY
from pdgw.dsp402.states import State, state_of

_SPEED_MODES: Final = (Mode.VELOCITY, Mode.CYCLIC_VELOCITY, Mode.VL_VELOCITY)
_NO_MODE: Final = 0


class ModeCheck(Part):
    """Checks the mode of one drive. ``notify`` is called with an event of the node and its text."""

    def __init__(self, sdo: ConfiguringAccess, feedback: DriveFeedback, notify: Callable[[Notice, str], None]) -> None:
        self._sdo = sdo
        self._feedback = feedback
        self._notify = notify
        self.awaited: int | None = None
        """A mode that 6061h has not shown yet; no speed is sent meanwhile."""
        self._operation = Operation()
        self._operating_since = -1

    @property
    def has_work(self) -> bool:
        return self.awaited is not None

    def configure(self, plan: PdoPlan, operation: Operation) -> None:
        self._operation = operation

    def set(self, mode: int, *, late: bool, only: bool) -> None:
        """Write a mode and wait until 6061h shows it; Dsp402Error if it does not.

        A speed mode may be shown later, in operation: the drive is known for it (``late``), or shows no mode at all. A drive with
        objects of this mode ``only`` needs neither 6060h nor 6061h (both are conditional in CiA 402).
        """
        sdo = self._sdo
        self.awaited, self._operating_since = None, -1
        if only and not {MODE[0], MODE_DISPLAY[0]} & sdo.dictionary.keys():
            self._notify(
                Notice.PROGRESS, f"without 6060h and 6061h: operated in its one mode, {mode} ({MODE_NAMES[Mode(mode)]})"
            )
            return
        sdo.do(SdoStep(*MODE, CanType.I8, mode, "mode of operation"))
        deadline = sdo.loop.now() + MODE_CONFIRM_NS
        while (shown := sdo.require(*MODE_DISPLAY, signed=True)) != mode:
            if mode in _SPEED_MODES and (late or (shown == _NO_MODE and sdo.loop.now() > deadline)):
                self.awaited = mode
                self._notify(
                    Notice.PROGRESS, f"6061h shows {shown}: mode {mode} is checked again when the operation is enabled"
                )
                return
            if sdo.loop.now() > deadline:
                raise Dsp402Error("6061h", shown, f"{mode} within {MODE_CONFIRM_NS / SECOND:g} s of 6060h")
            sdo.loop.sleep(10 * MS)

    def due(self, now: int) -> bool:
        return self.awaited is not None

    def work(self, now: int) -> None:
        """In operation 6061h must show the mode that is awaited."""
        mode = self.awaited
        if mode is None:
            return
        if state_of(self._feedback.statusword) is not State.OPERATION_ENABLED:
            self._operating_since = -1
            return
        if self._operating_since < 0:
            self._operating_since = now
        shown = self._sdo.read_number(*MODE_DISPLAY, signed=True)
        if shown == mode:
            self.awaited = None
        elif now - self._operating_since > MODE_CONFIRM_NS:
            self._operation.lost = f"6061h shows {shown} for {MODE_CONFIRM_NS / SECOND:g} s in operation, not {mode}"
