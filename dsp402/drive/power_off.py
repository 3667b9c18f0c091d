"""What waits until a drive has no power: values of its files, and values of another master that are corrected."""

from __future__ import annotations

from collections.abc import Callable

from pdgw.ds301.node.device_values import DeviceConfiguration
from pdgw.ds301.node.operation import Part
from pdgw.dsp402.drive.images import DriveFeedback
from pdgw.dsp402.drive.left_overs import OFF, LeftOvers
from pdgw.dsp402.states import state_of


class PowerOff(Part):
    """Of one drive. ``bring_up`` is called for the values of its files, ``read_again`` for the others."""

    def __init__(
        self,
        configuration: DeviceConfiguration,
        left_overs: LeftOvers,
        feedback: DriveFeedback,
        bring_up: Callable[[], None],
        read_again: Callable[[], None],
    ) -> None:
        self._configuration = configuration
        self._left_overs = left_overs
        self._feedback = feedback
        self._bring_up = bring_up
        self._read_again = read_again

    def due(self, now: int) -> bool:
        waits = self._left_overs.waits or self._configuration.waiting != ""
        return waits and state_of(self._feedback.statusword) in OFF

    def work(self, now: int) -> None:
        (self._bring_up if self._configuration.waiting else self._read_again)()
