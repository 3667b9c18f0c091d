"""An axis machine with a drive that shows what the test says: one cycle at a time, from STW1 and Statusword to Controlword."""

from __future__ import annotations

from typing import Self

from pdgw.dsp402.drive_type import DriveType
from pdgw.dsp402.states import STATUS_OF, State
from pdgw.gateway.axis.settings import AxisSettings
from tests.support.axis.stepper import Stepper

OFF, ON = 0x043E, 0x043F
"""STW1 of a telegram with positions: bits 4 and 5 are set."""
OPERATING = STATUS_OF[State.OPERATION_ENABLED]
_CYCLE_NS = 4_000_000


class Hand:
    """A call is a cycle. ``feedback`` and ``mode`` (6061h) are the test's to change; ``values`` are sent with each STW1."""

    def __init__(
        self,
        number: int,
        drive: DriveType,
        mode: int,
        values: dict[str, int],
        homing_method: int = 35,
        **settings: object,
    ) -> None:
        self.stepper = Stepper(number, AxisSettings(**{"cycle_ns": _CYCLE_NS, **settings}))  # type: ignore[arg-type]
        self.stepper.set_drive(drive, homing_method)
        self.feedback = self.stepper.feedback
        self.mode = mode
        self.values = dict.fromkeys(self.stepper.telegram.setpoints.names, 0) | values
        self.actuals: dict[str, int] = {}
        self.online = True
        self._now = 0

    def __call__(self, word: int | None, status: State | int = OPERATING, **values: int) -> int:
        """One cycle; the Controlword. ``word``: STW1, None without a PLC. ``status``: what the drive shows; ``values`` stay."""
        self._now += _CYCLE_NS
        self.values |= values
        feedback, telegram = self.feedback, self.stepper.telegram
        feedback.statusword = STATUS_OF[status] if isinstance(status, State) else status
        feedback.modes_of_operation_display = self.mode
        setpoints = None if word is None else telegram.setpoints.from_dict({**self.values, "STW1": word})
        self.actuals = telegram.actuals.as_dict(self.stepper.step(setpoints, feedback, self.online, self._now))
        return self.stepper.command.controlword

    def enable(self) -> Self:
        """OFF, then ON, and a cycle of operation."""
        self(OFF, State.SWITCH_ON_DISABLED)
        self(ON, State.READY_TO_SWITCH_ON)
        self(ON, State.SWITCHED_ON)
        self(ON)
        return self

    @property
    def latency(self) -> int:
        """Cycles after which what the drive shows is its answer."""
        return self.stepper.settings.latency_ns // _CYCLE_NS

    @property
    def target(self) -> int:
        """Target Position 607Ah."""
        return self.stepper.command.target_position
