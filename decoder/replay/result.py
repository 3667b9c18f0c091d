"""The result of a replay of one axis: its steps, and the differences from the recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from pdgw.decoder.replay.recorded import Answer, AxisRecording
from pdgw.dsp402.objects import DRIVE_OBJECTS, MAX_TORQUE
from pdgw.gateway.axis.values import FaultRecord
from pdgw.gateway.reasons import Reason


@dataclass(frozen=True)
class Difference:
    """A difference between the recording and the replay by the present gateway.

    ``what`` is ``actual values``, ``RPDO n`` or ``SDO``; ``recorded`` and ``today`` map signal or object names to raw values
    (None: nothing was or would be sent there).
    """

    time_ns: int
    do_id: int
    what: str
    recorded: Mapping[str, int] | None
    today: Mapping[str, int] | None
    note: str = ""

    @property
    def names(self) -> tuple[str, ...]:
        """The different values, in the order of the frame."""
        recorded, today = self.recorded or {}, self.today or {}
        return tuple(name for name in {**recorded, **today} if recorded.get(name) != today.get(name))


class Step(NamedTuple):
    """One replayed cycle. ``setpoints`` and ``feedback`` count the used events.

    ``controlword``, ``actuals`` and ``reason`` are those of this version's machine; ``compared`` is False while its earlier
    state is unknown.
    """

    time_ns: int
    answer: Answer | None
    setpoints: int
    feedback: int
    controlword: int
    actuals: tuple[int, ...]
    reason: Reason | None
    events: tuple[FaultRecord, ...]
    compared: bool


@dataclass
class AxisReplay:
    """The outcome for one axis: every step and the differences in their order."""

    recording: AxisRecording
    steps: list[Step] = field(default_factory=list)
    differences: list[Difference] = field(default_factory=list)

    @property
    def compared(self) -> int:
        """Steps that were compared."""
        return sum(step.compared for step in self.steps)

    @property
    def not_compared(self) -> tuple[str, ...]:
        """Objects that the gateway sent and that are not compared, because the recording does not show their base."""
        recording = self.recording
        if recording.torque_is_known:
            return ()
        sent = recording.torque_places or any((item.index, item.subindex) == MAX_TORQUE for item in recording.sdo)
        return (DRIVE_OBJECTS.entry(*MAX_TORQUE).name,) if sent else ()
