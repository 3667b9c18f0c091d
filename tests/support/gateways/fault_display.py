"""Does the status word of a telegram show what the fault buffer (P947) and the warning word (P953) have?"""

from __future__ import annotations

from pdgw.gateway.axis.supervision.drive_events import EMERGENCY_PATIENCE_NS
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.objects.axis import Axis
from pdgw.gateway.objects.drive_object import DriveObject
from pdgw.gateway.objects.encoder import EncoderObject
from pdgw.gateway.parameters.objects import RequestContext
from pdgw.gateway.parameters.profile import AxisObject, EncoderChannelObject
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.parameters.codec import Values
from pdgw.profidrive.parameters.description import Pnu
from pdgw.profidrive.parameters.faults import FAULTS_PER_SITUATION
from pdgw.profidrive.signals import signal

_FAULT = signal("ZSW1").bit("FAULT").mask
_WARNING = signal("ZSW1").bit("WARNING").mask
_WORDS = ("ZSW1", "ZSW2_ENC")
"""Their bits 3 and 7 are the same."""


def drive_state(zsw1: int) -> int:
    """ZSW1 bits 0 to 2 and 6, and bit 3 only of a drive in fault: of any other it shows a fault that is not acknowledged.

    Of -1, for values that are not valid, all of them.
    """
    return zsw1 & 0x4F if zsw1 < 0 else zsw1 & 0x47 or zsw1 & _FAULT


class FaultDisplay:
    """Call it after each cycle. A fault of P947 without its acknowledge is bit 3 from the next cycle on, a warning of P953 bit 7.
    Bit 3 of a device that is online has a fault in P947 as soon as its EMCY or its code can be there.

    Telegram 100 shows the Statusword of the drive and is not checked.
    """

    def __init__(self, daemon: Daemon, item: DriveObject) -> None:
        self._daemon, self._item = daemon, item
        if isinstance(item, Axis):
            self._parameters: AxisObject | EncoderChannelObject = AxisObject(daemon, item)
        else:
            assert isinstance(item, EncoderObject)
            self._parameters = EncoderChannelObject(daemon, item)
        self._context = RequestContext()
        self._cycle: int | None = None
        """The cycle of the gateway after which there was a fault first."""
        self._unnamed = 0
        """Cycles in succession with bit 3 and without a fault in P947."""

    def read(self, pnu: int, elements: int = 0) -> list[int]:
        """Values of a parameter, as a client gets them."""
        return [int(value) for value in self._parameters.parameter(int(pnu), self._context).read(0, elements).values]

    @property
    def faults(self) -> list[int]:
        """P947, situation 0."""
        return [number for number in self.read(Pnu.FAULT_NUMBER, FAULTS_PER_SITUATION) if number]

    @property
    def warnings(self) -> int:
        """P953."""
        return self.read(Pnu.WARNING_WORD)[0]

    def clear(self) -> None:
        """P952 := 0."""
        self._parameters.parameter(Pnu.FAULT_SITUATIONS, self._context).write(0, 0, Values(DataType.UNSIGNED16, (0,)))

    def __call__(self) -> None:
        names = self._item.telegram.actuals.names
        name = next((name for name in _WORDS if name in names), None)
        warnings, cycle = self.warnings, self._daemon.cycles
        if not self.faults:
            self._cycle = None
        elif self._cycle is None:
            self._cycle = cycle
        if name is not None:
            word = self._item.actuals[names.index(name)]
            due = self._cycle is not None and self._cycle < cycle
            must = _FAULT * due | _WARNING * (warnings != 0)
            assert word & must == must, f"{name} {word:04X}h, P947 {self.faults}, P953 {warnings:04X}h"
            self._unnamed = self._unnamed + 1 if word & _FAULT and self._item.good and not self.faults else 0
            assert self._unnamed * self._daemon.cycle_ns < 2 * EMERGENCY_PATIENCE_NS, (
                f"{name} {word:04X}h, P947 is empty"
            )
