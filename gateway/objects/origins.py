"""Origins: what began the stop of a drive object, by whom and when.

The first event of a stop is its origin, and what follows is a consequence. It is kept until ON works again; a severe one until
the fault is acknowledged.
"""

from __future__ import annotations

from typing import Final

from pdgw.base.durations import SECOND
from pdgw.ds301.emcy import emcy_remedy
from pdgw.ds301.loop.loop import Loop
from pdgw.dsp402.states import State
from pdgw.gateway.axis.supervision.drive_events import EMERGENCY_PATIENCE_NS
from pdgw.gateway.axis.values import FaultRecord
from pdgw.gateway.base.fault_numbers import GATEWAY_FAULTS, By, FaultNumber, Weight
from pdgw.gateway.base.finding_text import finding_text
from pdgw.gateway.base.reasons import Finding, Reason

_LACKS: Final = {
    State.NOT_READY_TO_SWITCH_ON: "self test or supply",
    State.SWITCH_ON_DISABLED: "safe torque off (STO), enable input or supply",
}
"""What a drive lacks in a state that Shutdown must end at once. In the others it lacks what its power stage needs."""


def used_up(state: State, enter_ns: int, *, supply: bool, remote: bool) -> Finding:
    """An ON that the drive has not followed from a state, in the time ``enter_ns`` of its power stage.

    ``supply``: the drive does not show that it lacks its supply; ``remote``: nor that it is in local mode (Statusword.9).
    """
    lacks, time, todo = _LACKS.get(state, ""), "", Reason.INHIBITED.remedy
    if not lacks:
        lacks, time = "main contactor, DC link or enable input", f" for {enter_ns / SECOND:g} s (enter_ms)"
    if not supply:
        lacks, todo = "no supply voltage (Statusword.4 = 0)", Reason.NO_SUPPLY.remedy
    elif not remote:
        lacks, todo = f"{lacks}, or local mode (Statusword.9 = 0)", (*Reason.LOCAL_MODE.remedy, *todo)
    text = f"the drive did not leave {state.value}{time} after ON: {lacks}"
    return Finding(Reason.INHIBITED, text, todo, by=By.DRIVE)


_SUSPECTED: Final = (0, FaultNumber.NODE_LOST, FaultNumber.NODE_RESTARTED, FaultNumber.LEFT_OPERATION)
_GUESSED: Final = (By.NODE, By.DRIVE)
"""Losses with the first symptom as their cause, and not another master or the gateway."""
PROOF_NS: Final = 2 * SECOND
"""What is proven within this time of a guess replaces it."""


def of_fault(record: FaultRecord) -> Finding:
    """A fault as an origin, with the remedy of its number if it has none of its own."""
    fault, time = GATEWAY_FAULTS.get(record.number), record.time_ns
    remedy = (emcy_remedy(record.code),) if fault is None else fault.remedy
    return Finding(
        Reason.NEEDS_OFF,
        record.text,
        (record.remedy,) if record.remedy else remedy,
        since_ns=time,
        last_ns=time,
        times=1,
        by=By.DRIVE if fault is None else record.by or fault.by,
        number=record.number,
        code=record.code,
    )


class Origins:
    """The origin of one drive object."""

    def __init__(self, now: int) -> None:
        self.present: Finding | None = Finding.of(Reason.NEEDS_OFF, "the gateway has started")._replace(since_ns=now)
        """Why ON is ignored; None while the drive follows the PLC."""
        self.severe: Finding | None = None
        """The first severe fault that is not acknowledged."""
        self._recalled = ""
        self._proof: Finding | None = None
        """What was proven last."""

    def recall(self, ended: str, before: str) -> None:
        """How the last gateway ended, and what it has kept with ``last``."""
        assert self.present is not None, "before the start"
        self._recalled = before
        self.present = self.present._replace(ended=ended or "an earlier one has left no word", before=before)

    def last(self, loop: Loop) -> str:
        """What began the last stop, as text for the next gateway; empty if only the gateway itself did."""
        origin = self.severe or self.present
        if origin is None or (origin.by is By.GATEWAY and not origin.number) or origin.since_ns is None:
            return self._recalled
        return finding_text(origin, loop, dated=True)

    def of(self, record: FaultRecord) -> Finding:
        """That of a fault; of an older one with what the last gateway has kept."""
        fault = of_fault(record)
        return fault._replace(since_ns=None, before=self._recalled) if record.is_older else fault

    def enter(self, record: FaultRecord) -> None:
        """A fault is reported."""
        present, fault = self.present, GATEWAY_FAULTS.get(record.number)
        if record.is_warning:
            return
        if fault is not None and fault.weight is Weight.SEVERE and self.severe is None:
            self.severe = of_fault(record)
        if present is not None and present.times and present.number == record.number:
            self.present = present._replace(times=present.times + 1, last_ns=record.time_ns)
        elif (
            present is None
            or present.number in (0, record.number)
            # The device says why it left operation, before or shortly after that.
            or (
                present.number == FaultNumber.LEFT_OPERATION
                and record.of_device
                and record.time_ns - present.period[0] < EMERGENCY_PATIENCE_NS
            )
        ):
            self.present = self.of(record)
            self._replace_guess()

    def prove(self, proof: Finding) -> None:
        """What a loss really is was proven: this replaces the guess from its first symptom, which may be reported later."""
        self._proof = proof
        self._replace_guess()

    def _replace_guess(self) -> None:
        present, proof = self.present, self._proof
        if present is None or proof is None or present.number not in _SUSPECTED or present.by not in _GUESSED:
            return
        if abs(present.period[1] - proof.period[0]) <= PROOF_NS:
            self.present = present._replace(by=proof.by, evidence=proof.evidence, remedy=proof.remedy)

    def released(self, now: int) -> None:
        """The drive follows the PLC, and nothing of this cycle stops it."""
        if self.present is not None and self.present.period[1] < now:
            self.present, self._recalled = None, ""

    def returned(self, now: int) -> None:
        """The PLC sends setpoints again."""
        present = self.present
        if present is not None and present.reason.past not in ("", present.evidence):
            past, remedy = present.reason.past, Reason.NEEDS_OFF.remedy
            self.present = present._replace(evidence=past, remedy=remedy, until_ns=now)

    def acknowledged(self) -> None:
        """The faults are acknowledged: what happens next is not their consequence."""
        self.severe = None
        if self.present is not None and self.present.number:
            self.present = self.present._replace(times=0, number=0)
