"""What is special about drives when they get the values of their files: power, units, and what RPDOs overwrite.

Source: CiA 402-2; manuals of drives. Many drives take units, polarity and ranges only after storing and a restart: before that
they show the new value and act by the old one.
"""

from __future__ import annotations

from typing import Final

from pdgw.ds301.node.configuring import ConfiguringAccess
from pdgw.ds301.node.device_values import ValueWriter
from pdgw.ds301.objects import ObjectAddress
from pdgw.dsp402 import objects
from pdgw.dsp402.drive.left_overs import OFF
from pdgw.dsp402.drive.own_values import OwnValueKeeper
from pdgw.dsp402.identification.overlay import Overlay
from pdgw.dsp402.objects import STATUSWORD
from pdgw.dsp402.states import State, state_of

_UNITS: Final = frozenset(
    (
        objects.VL_SETPOINT_FACTOR,
        objects.VL_DIMENSION_FACTOR,
        objects.POSITION_RANGE_LIMIT,
        objects.HOME_OFFSET,
        objects.POLARITY,
        *range(objects.POSITION_NOTATION, objects.ACCELERATION_FACTOR + 1),
        *range(objects.SI_UNIT_POSITION, objects.SI_UNIT_ACCELERATION + 1),
    )
)
"""Units, polarity, range and zero of positions."""


class DriveValueWriter(ValueWriter):
    """The values of one drive."""

    def __init__(self, sdo: ConfiguringAccess, own_values: OwnValueKeeper) -> None:
        super().__init__(sdo)
        self._own_values = own_values
        self.family: Overlay | None = None
        """The overlay of the drive that is there."""

    def acts_after_restart(self, index: int) -> bool:
        family = self.family
        return index in _UNITS or (family is not None and index in family.act_after_restart)

    def obstacle(self) -> str:
        state = state_of(self._sdo.read_number(*STATUSWORD))
        if state in OFF:
            return ""
        return f"the drive is in {'an unknown state' if state is None else state.value}: switch its power stage off"

    def urgent(self) -> bool:
        return state_of(self._sdo.read_number(*STATUSWORD)) is State.OPERATION_ENABLED

    def own_value(self, address: ObjectAddress) -> int | None:
        return self._own_values.value(address)

    def written(self, address: ObjectAddress) -> None:
        self._own_values.discard(address)
