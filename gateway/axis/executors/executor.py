"""Interface of executors to the machine, and their common functions.

An executor reads and writes the ``AxisRecords`` of its axis. The machine calls ``step`` while the drive is known well enough,
else ``refuse``.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Final, NamedTuple

from pdgw.dsp402.drive.images import DEMAND_UNKNOWN, DriveCommand, DriveFeedback
from pdgw.dsp402.drive_type import DriveType, Dsp402Error, Quantity
from pdgw.dsp402.states import STATE_OF_STATUS, State, StatusBit
from pdgw.gateway.axis.demand_report import Demand, Report
from pdgw.gateway.axis.interlock import Interlock
from pdgw.gateway.axis.settings import AxisSettings
from pdgw.gateway.axis.values import Inputs, Outputs, ProbeAnswer
from pdgw.gateway.base.fault_numbers import FaultNumber, warning_bits
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.motion.requests import Lack
from pdgw.gateway.motion.travel import LIMIT_LEFT_NS, LIMIT_STANDING_NS
from pdgw.profidrive.normalisation import Normalisation

AT_LIMIT: Final = warning_bits(FaultNumber.INTERNAL_LIMIT)
AT_LIMIT_TEXT: Final = "limit switch, position or speed limit"
OPERATION_ENABLED = tuple(state is State.OPERATION_ENABLED for state in STATE_OF_STATUS)
"""By the Statusword under ``STATE_MASK``."""


class AxisRecords(NamedTuple):
    """The records that an executor reads and writes in each step. The objects never change."""

    settings: AxisSettings
    interlock: Interlock
    """Command in: ``cell`` and ``controlword``, and the ``reason`` why they are not what the PLC asks."""
    demand: Demand
    """Command in: what the PLC asks, as the adapter of the telegram has it."""
    inputs: Inputs
    """Feedback in: values of the drive, the standstill and the time."""
    outputs: Outputs
    """Command and notes out: what the drive gets, faults and warnings, SDO writes, the probe, the count of limited values."""


class Executor:
    """One kind of operation of one drive."""

    def __init__(self, records: AxisRecords) -> None:
        self.settings, self.interlock, _, self.inputs, self.outputs = records
        self.feedback: DriveFeedback = records.inputs.feedback
        self.command: DriveCommand = records.outputs.command
        self.report = Report()
        self.slowest = 0
        """Lowest speed that the drive may have with any setpoint in force, in its units: that of an inverter (6046h)."""

    def set_drive(self, drive: DriveType, homing_method: int) -> None:
        """Set the drive: at the start, after a write to a reference object, after a restart of the drive.

        Dsp402Error if it lacks something that the telegram needs.
        """
        raise NotImplementedError

    def restarted(self) -> None:
        """The drive booted or was configured again; cycles out of operation follow (``power_table``)."""

    @property
    def limit_side(self) -> int:
        """1 or -1: the direction in which a limit of the drive has stopped the axis; 0: none, or unknown."""
        return 0

    @property
    def range_note(self) -> str:
        """For the user: where the positions of the drive end, or that only the profile says that they wrap; empty: neither."""
        return ""

    @property
    def homes_since(self) -> int:
        """Since when the axis homes, monotonic ns; 0: it does not."""
        return 0

    @property
    def home_lost(self) -> int:
        """When the home position was lost with the drive, monotonic ns; 0: it was not, or there is a new one."""
        return 0

    @property
    def needs_home(self) -> bool:
        """An absolute task runs."""
        return False

    @property
    def ignored(self) -> int:
        """Bits of STW1 that are 1 and start nothing."""
        return 0

    def lack(self, mask: int) -> Lack:
        """Why the last edge of bits of STW1 that start something started nothing; 0: the active function."""
        return Lack("both are 1")

    def lost(self) -> None:
        """The drive is not there; called after the step of such a cycle."""

    def refuse(self) -> Report:
        """Without valid references nothing is converted; the drive gets the Controlword and nothing else."""
        raise NotImplementedError

    def sdo_done(self, error: str | None) -> None:
        """``Outputs.writes`` are done (None) or failed (the reason)."""

    def probed(self, answer: ProbeAnswer) -> None:
        """Result of ``Outputs.probe``."""

    def step(self) -> Report:
        """One cycle: the command with bits 0-3 and 7 of the Controlword as given. The reason in the report is that of the
        interlock, or its own."""
        raise NotImplementedError

    def speeds(self) -> tuple[int, int] | None:
        """The lowest and the highest speed that the drive may have by its setpoints, in its units; None: they do not say."""
        return None

    def limited(self, conversion: Normalisation, wire: int) -> int:
        """A fraction in the drive's units; one that a limit cuts is counted."""
        value = conversion.to_value(wire)
        if not conversion.value_min < value < conversion.value_max:
            self.cuts(conversion, wire)
        return value

    def cuts(self, conversion: Normalisation, wire: int) -> bool:
        """Whether a limit cuts this fraction, which is counted."""
        cut = conversion.saturates(wire)
        self.outputs.saturations += cut
        return cut


def known(value: Fraction | None, what: str, key: str) -> Fraction:
    """A scaling of the drive; Dsp402Error if it is unknown."""
    if value is None:
        raise Dsp402Error(what, "not known", f"a drive that reports it, or the key {key}")
    return value


def highest(drive: DriveType, quantity: Quantity, *attributes: str) -> int:
    """100 % of a quantity, limited to the range of these objects; Dsp402Error if it is unknown or below 1."""
    limits = [drive.limits(attribute)[1] for attribute in attributes if drive.has(attribute)]
    found = min([int(drive.scaling.reference(quantity)), *limits])
    if found < 1:
        raise Dsp402Error(f"100 % of the {quantity.value}", found, "at least one unit of the drive's object")
    return found


def demanded_speed(feedback: DriveFeedback) -> int:
    """The speed where the ramp of the drive is: its demand value (606Bh), else its actual value (606Ch)."""
    demand = feedback.velocity_demand
    return feedback.velocity_actual if demand == DEMAND_UNKNOWN else demand


class LimitWatch:
    """Whether a limit of the drive (Statusword.11) keeps the axis from its setpoint.

    The bit may also be 1 while the axis follows, or at rest on a limit switch. It counts when the axis has been slower than
    commanded for ``LIMIT_STANDING_NS`` and has become no faster.
    """

    def __init__(self) -> None:
        self.shown = False
        """The drive reports a limit."""
        self.limits = False
        """It keeps the axis from its setpoint."""
        self._rests = False
        """The bit was there before the axis was commanded to move: this may be the way out."""
        self._direction = 0
        self._since = -1
        """When the axis was fastest since the present limit."""
        self._fastest = 0

    def reset(self) -> None:
        """The drive reports no limit."""
        self.shown = self.limits = self._rests = False
        self._since = -1

    def step(self, wanted: int, tolerance: int, executor: Executor) -> bool:
        """One cycle with the commanded speed; True when the limit has stopped the axis."""
        inputs, feedback = executor.inputs, executor.feedback
        if not feedback.statusword & StatusBit.INTERNAL_LIMIT:
            self.reset()
            return False
        now, standstill = inputs.now, inputs.standstill
        self.shown = True
        self._rests = standstill and (self._rests or not wanted)
        speed = feedback.velocity_actual if wanted > 0 else -feedback.velocity_actual
        full = abs(wanted)
        if not wanted or speed + min(tolerance, full >> 1) >= full:
            self._since = -1
        elif self._since < 0 or wanted * self._direction < 0 or speed > self._fastest:
            self._since, self._fastest, self._direction = now, speed, wanted
        waited = now - self._since if self._since >= 0 else 0
        self.limits = waited >= LIMIT_STANDING_NS
        return standstill and waited >= (LIMIT_LEFT_NS if self._rests else LIMIT_STANDING_NS)

    def report(self, outputs: Outputs, *, held: bool) -> Reason | None:
        """The reason of an axis that the limit keeps from its setpoint, and the warning. ``held``: it is stopped there."""
        if held or (self.limits and not self._rests):
            outputs.warn(FaultNumber.INTERNAL_LIMIT, AT_LIMIT_TEXT)
        else:
            outputs.end_warnings(AT_LIMIT)
        if held:
            return Reason.STOPPED_AT_LIMIT
        return Reason.INTERNAL_LIMIT if self.limits else None
