"""The executor of each kind of telegram."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from pdgw.gateway.axis.adapters.transparent import ACTUAL_ATTRIBUTES, SETPOINT_ATTRIBUTES
from pdgw.gateway.axis.executors.dsc import DscExecutor
from pdgw.gateway.axis.executors.executor import AxisRecords, Executor
from pdgw.gateway.axis.executors.positions.tasks import PositionerExecutor
from pdgw.gateway.axis.executors.positions.telegram_9 import PositioningExecutor
from pdgw.gateway.axis.executors.raw import RawExecutor
from pdgw.gateway.axis.executors.speed import SpeedExecutor
from pdgw.gateway.axis.executors.torque import TorqueExecutor
from pdgw.gateway.axis.telegrams import Kind

EXECUTORS: dict[Kind, Callable[[AxisRecords], Executor]] = {
    Kind.SPEED: SpeedExecutor,
    Kind.DSC: DscExecutor,
    Kind.LOAD: SpeedExecutor,
    Kind.TORQUE: TorqueExecutor,
    Kind.POSITIONING: PositioningExecutor,
    Kind.POSITIONER: PositionerExecutor,
    Kind.RAW: partial(RawExecutor, setpoints=SETPOINT_ATTRIBUTES, actuals=ACTUAL_ATTRIBUTES),
}
"""GatewayError of a constructor: the settings lack something that the telegram needs."""
