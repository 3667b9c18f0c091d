"""Alarms and warnings of an encoder: read by SDO from time to time, and at once after an EMCY."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from pdgw.ds301.communication import ERROR_REGISTER
from pdgw.ds301.node.configuring import ConfiguringAccess
from pdgw.ds301.node.emergencies import SHORTEST_EMCY
from pdgw.ds301.node.operation import Operation, Part
from pdgw.ds301.node.plan import PdoPlan
from pdgw.ds301.node.polled import FAILURES
from pdgw.dsp406.images import EncoderFeedback
from pdgw.dsp406.objects import ALARMS, WARNINGS

_OBJECTS: Final = (("alarms", ALARMS), ("warnings", WARNINGS), ("error_register", ERROR_REGISTER))


class Diagnosis(Part):
    """Of one encoder. ``period_ns``: longest time between two readings."""

    def __init__(self, sdo: ConfiguringAccess, feedback: EncoderFeedback, period_ns: Callable[[], int]) -> None:
        self._sdo = sdo
        self._feedback = feedback
        self._period_ns = period_ns
        self._operation = Operation()
        self._read_at = 0
        self._asked = False
        """An EMCY has come since the last reading."""
        self._unread = 0
        """So often in a row the objects could not be read."""

    def configure(self, plan: PdoPlan, operation: Operation) -> None:
        self._operation = operation

    def due(self, now: int) -> bool:
        return self._asked or now - self._read_at >= self._period_ns()

    def work(self, now: int) -> None:
        self._read_at = now
        self.read()

    def read(self) -> None:
        """Read them, in the node's task."""
        self._asked = False
        self._unread += 1
        if self._unread >= FAILURES:
            self._operation.lost = f"alarms and warnings could not be read {self._unread} times"
        for name, index in _OBJECTS:
            if index in self._sdo.dictionary:
                setattr(self._feedback, name, self._sdo.require(index))
        self._unread, self._operation.lost = 0, ""

    def on_emergency(self, data: bytes) -> None:
        """An EMCY of the encoder."""
        if len(data) >= SHORTEST_EMCY:
            self._feedback.error_code = int.from_bytes(data[:2], "little")
            self._feedback.error_register = data[2]
        self._asked = True
