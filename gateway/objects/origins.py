"""Origins: what began the stop of a drive object, by whom and when.

The first event of a stop is its origin, and what follows is a consequence. It is kept until ON works again; a severe one until
the fault is acknowledged.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Final

from pdgw.base.durations import SECOND
from pdgw.ds301.emcy import emcy_remedy
from pdgw.ds301.loop.loop import Loop
from pdgw.dsp402.states import State
from pdgw.gateway.axis.supervision.drive_events import EMERGENCY_PATIENCE_NS
from pdgw.gateway.axis.values import FaultRecord
from pdgw.gateway.base.reasons import GATEWAY_FAULTS, By, FaultNumber, Reason
from pdgw.gateway.base.steps import Remedy

ORDERS: Final[dict[Reason | None, str]] = {
    Reason.RAMP_STOP: "ON came before the end of the OFF1 ramp",
    Reason.QUICK_STOP: "the PLC has sent OFF3 (STW1.2 = 0)",
    Reason.COAST_STOP: "the PLC has sent OFF2 (STW1.1 = 0)",
    Reason.LOCAL_MODE: "ON came while the drive was in local mode (Statusword.9 = 0)",
}
"""Stops that the PLC orders, and an ON that came too early, by the reason of the interlock."""

_LACKS: Final = {
    State.NOT_READY_TO_SWITCH_ON: "self test or supply",
    State.SWITCH_ON_DISABLED: "safe torque off (STO), enable input or supply",
}
"""What a drive lacks in a state that Shutdown must end at once. In the others it lacks what its power stage needs."""


def used_up(state: State, enter_ns: int, *, supply: bool, remote: bool) -> tuple[str, Remedy]:
    """Evidence and remedy of an ON that the drive has not followed from a state, in the time ``enter_ns`` of its power stage.

    ``supply``: the drive does not show that it lacks its supply; ``remote``: nor that it is in local mode (Statusword.9).
    """
    lacks, time, todo = _LACKS.get(state, ""), "", Reason.INHIBITED.remedy
    if not lacks:
        lacks, time = "main contactor, DC link or enable input", f" for {enter_ns / SECOND:g} s (enter_ms)"
    if not supply:
        lacks, todo = "no supply voltage (Statusword.4 = 0)", Reason.NO_SUPPLY.remedy
    elif not remote:
        lacks, todo = f"{lacks}, or local mode (Statusword.9 = 0)", (*Reason.LOCAL_MODE.remedy, *todo)
    return f"the drive did not leave {state.value}{time} after ON: {lacks}", todo


_SUSPECTED: Final = (0, FaultNumber.NODE_LOST, FaultNumber.NODE_RESTARTED, FaultNumber.LEFT_OPERATION)
_GUESSED: Final = (By.NODE, By.DRIVE)
"""Losses with the first symptom as their cause, and not another master or the gateway."""
PROOF_NS: Final = 2 * SECOND
"""What is proven within this time of a guess replaces it."""


@dataclass(slots=True)
class Origin:
    """What began a stop. Times are monotonic nanoseconds."""

    by: By
    evidence: str
    first_ns: int
    remedy: Remedy = Reason.NEEDS_OFF.remedy
    number: int = 0
    """Its fault (P947); 0: no fault."""
    last_ns: int = 0
    count: int = 0
    """How often its fault was reported."""
    past: str = ""
    """The evidence when it is over and only OFF and ON are missing; empty: the evidence stays true."""
    ended_ns: int = 0
    """When it was over; 0: it is not, or its end does not matter."""
    ended: str = ""
    """Of a start: how the last gateway ended,"""
    before: str = ""
    """and what had stopped the drive object then."""

    @classmethod
    def of(cls, record: FaultRecord) -> Origin:
        """That of a fault."""
        fault, time, evidence, place = GATEWAY_FAULTS.get(record.number), record.time_ns, record.text, record.remedy
        if fault is None:
            return cls(By.DRIVE, evidence, time, (place or emcy_remedy(record.code),), record.number, time, 1)
        todo = (place,) if place else fault.remedy
        return cls(record.by or fault.by, evidence, time, todo, record.number, time, 1)


def clock(time_ns: int, loop: Loop) -> str:
    """The time of day of a monotonic time."""
    return f"{datetime.fromtimestamp(loop.wall() - (loop.now() - time_ns) / SECOND):%H:%M:%S}"


def since(origin: Origin, loop: Loop) -> str:
    """The text of an origin, since when, and how often."""
    if origin.ended_ns:
        return f"{origin.evidence} from {clock(origin.first_ns, loop)} to {clock(origin.ended_ns, loop)}"
    times = f" ({origin.count} times)" if origin.count > 1 else ""
    ended = f"; {origin.ended}" if origin.ended else ""
    before = f"; before: {origin.before}" if origin.before else ""
    return f"{origin.evidence}, since {clock(origin.first_ns, loop)}{times}{ended}{before}"


class Origins:
    """The origin of one drive object."""

    def __init__(self, now: int) -> None:
        self.present: Origin | None = Origin(By.GATEWAY, "the gateway has started", now)
        """Why ON is ignored; None while the drive follows the PLC."""
        self.severe: Origin | None = None
        """The first severe fault that is not acknowledged."""
        self._recalled = ""
        self._proof: Origin | None = None
        """What was proven last."""

    def recall(self, ended: str, before: str) -> None:
        """How the last gateway ended, and what it has kept with ``last``."""
        assert self.present is not None, "before the start"
        self._recalled = before
        self.present.ended, self.present.before = ended or "an earlier one has left no word", before

    def last(self, loop: Loop) -> str:
        """What began the last stop, as text; empty if only the gateway itself did."""
        origin = self.severe or self.present
        if origin is None or (origin.by is By.GATEWAY and not origin.number):
            return self._recalled
        return since(origin, loop)

    def enter(self, record: FaultRecord) -> None:
        """A fault is reported."""
        present, fault = self.present, GATEWAY_FAULTS.get(record.number)
        if record.is_warning:
            return
        if fault is not None and fault.severe and self.severe is None:
            self.severe = Origin.of(record)
        if present is not None and present.count and present.number == record.number:
            present.count += 1
            present.last_ns = record.time_ns
        elif (
            present is None
            or present.number in (0, record.number)
            # The device says why it left operation, before or shortly after that.
            or (
                present.number == FaultNumber.LEFT_OPERATION
                and record.of_device
                and record.time_ns - present.first_ns < EMERGENCY_PATIENCE_NS
            )
        ):
            self.present = Origin.of(record)
            self._replace_guess()

    def prove(self, by: By, evidence: str, remedy: Remedy, now: int) -> None:
        """What a loss really is was proven: this replaces the guess from its first symptom, which may be reported later."""
        self._proof = Origin(by, evidence, now, remedy)
        self._replace_guess()

    def _replace_guess(self) -> None:
        present, proof = self.present, self._proof
        if present is None or proof is None or present.number not in _SUSPECTED or present.by not in _GUESSED:
            return
        if abs((present.last_ns or present.first_ns) - proof.first_ns) <= PROOF_NS:
            present.by, present.evidence, present.remedy = proof.by, proof.evidence, proof.remedy

    def released(self, now: int) -> None:
        """The drive follows the PLC, and nothing of this cycle stops it."""
        if self.present is not None and self.present.last_ns < now:
            self.present, self._recalled = None, ""

    def returned(self, now: int) -> None:
        """The PLC sends setpoints again."""
        present = self.present
        if present is not None and present.past:
            present.evidence, present.remedy, present.ended_ns = present.past, Reason.NEEDS_OFF.remedy, now

    def acknowledged(self) -> None:
        """The faults are acknowledged: what happens next is not their consequence."""
        self.severe = None
        if self.present is not None and self.present.number:
            self.present.count = 0
            self.present.number = 0
