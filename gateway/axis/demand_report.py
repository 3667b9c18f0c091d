"""Interface between telegrams and drives: the request to an axis (``Demand``) and its actual state (``Report``).

Adapters change a ``Demand`` when the words of their telegram change. Executors fill their ``Report`` in each cycle. Fractions of
a reference are integers, 4000 0000h is 100 % (N4; N2 is converted without loss).
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from typing import Final

from pdgw.dsp402.states import STATE_OF_STATUS, State
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.motion.requests import NOTHING, PositionerRequest
from pdgw.profidrive.signals import signal

_ZSW1: Final = signal("ZSW1")


class PowerWish(enum.IntEnum):
    """Request to the power stage, in the order of the columns of the power table."""

    COAST = 0
    """OFF2: power off at once."""
    QUICK_STOP = 1
    """OFF3."""
    OFF = 2
    """OFF1, with neither of the above."""
    RAW_OFF = 3
    """The same in a telegram that carries the Controlword itself: what follows passes unchanged."""
    ON = 4
    """Power on, no operation."""
    ENABLE = 5
    """Operation."""
    RESUME = 6
    """ENABLE during a ramp stop where the user lets it resume: the interlock's own reading of ENABLE."""
    HOLD = 7
    """Stay in operation, start nothing: ENABLE without control by the PLC, with ``control_lost = "hold"``."""
    STOP = 8
    """As OFF1 in operation, but no OFF that releases anything: the PLC has no control."""
    NO_PLC_RAMP = 9
    """Without a PLC the axis ramps down to standstill. The three reactions to a loss are in the order of their rank."""
    NO_PLC_QUICK_STOP = 10
    """Without a PLC the axis makes a quick stop."""
    NO_PLC_COAST = 11
    """Without a PLC the axis coasts."""
    OFF_DISABLED = 12
    """OFF1, and STW1.3 fell to 0 (Disable Operation) while the axis was being stopped: the ramp ends."""
    QUICK_STOP_DISABLED = 13
    """OFF3, and STW1.3 fell to 0 (Disable Operation) while the axis was being stopped: the quick stop ends."""


OFF1S: Final = (PowerWish.OFF, PowerWish.OFF_DISABLED)
"""OFF1. In telegram 100, OFF is a Shutdown and resumes no ramp."""
OFFS: Final = (*OFF1S, PowerWish.RAW_OFF)
"""After one of these, ON counts."""


class SpeedWish(enum.IntEnum):
    """Treatment of the speed setpoint."""

    FOLLOW = 0
    HOLD = 1
    """The last Target Velocity stays."""
    ZERO = 2
    JOG_1 = 3
    """The speed of the user's choice, begun at standstill."""
    JOG_2 = 4
    FREEZE = 5
    """The ramp stops where it is: the demand speed of this moment stays."""


class Demand:
    """Request to an axis; the state of an adapter, whose kind of telegram has the other fields."""

    def __init__(self) -> None:
        self.connected = False
        """A PLC is in charge."""
        self.in_control = True
        """False while a connected PLC does not take control: the last request stays in force."""
        self.power: PowerWish = PowerWish.OFF
        """Meant while ``connected``."""
        self.acknowledge = False
        """Acknowledge a fault (level; its edge counts)."""


class SpeedDemand(Demand):
    """Request of a telegram with a speed."""

    def __init__(self) -> None:
        super().__init__()
        self.device_bits = 0
        """Bits 12-15 for the Controlword."""
        self.speed = 0
        """Fraction of the reference speed."""
        self.speed_wish: SpeedWish = SpeedWish.FOLLOW
        self.jogs = 0
        """Bits of STW1 that ask for a jog: those of the jogs, as long as STW1.4 to .6 are 0."""
        self.position_error = (0, 0)
        """XERR, position error of the PLC's controller in increments of G1, and KPC, its gain in 0.001/s; 0: no position control
        by the drive."""
        self.torque_reduction = 0
        """Reduction of the torque limit, as a fraction (N2); 0 or below: nothing."""


class MotionDemand(Demand):
    """Request of a telegram with positions."""

    def __init__(self) -> None:
        super().__init__()
        self.motion: PositionerRequest = NOTHING
        """Request to a positioner."""


class RawDemand(Demand):
    """Request of a transparent telegram."""

    def __init__(self) -> None:
        super().__init__()
        self.raw: Sequence[int] | None = None
        """Raw values for the objects, the Controlword first; None before there are any."""


class Flag:
    """Displayed states of an axis, as bits. The positions are those of ZSW1, so a mask gives the word."""

    NO_COAST_STOP: Final = _ZSW1.bit("NO_COAST_STOP").mask
    NO_QUICK_STOP: Final = _ZSW1.bit("NO_QUICK_STOP").mask
    WARNING: Final = _ZSW1.bit("WARNING").mask
    WITHIN_TOLERANCE: Final = _ZSW1.bit("WITHIN_TOLERANCE").mask
    REACHED: Final = _ZSW1.bit("TARGET_REACHED").mask
    HOME_SET: Final = _ZSW1.bit("HOME_POSITION_SET", positioning=True).mask
    TASK_ACKNOWLEDGED: Final = _ZSW1.bit("TASK_ACKNOWLEDGE", positioning=True).mask
    STANDING: Final = _ZSW1.bit("DRIVE_STOPPED", positioning=True).mask
    OF_THE_DRIVE: Final = (
        NO_COAST_STOP
        | NO_QUICK_STOP
        | WARNING
        | _ZSW1.bit("CONTROL_REQUESTED").mask
        | _ZSW1.bit("DEVICE_14").mask
        | _ZSW1.bit("DEVICE_15").mask
    )
    """Statusword bits that are shown unchanged (docs/telegrams.md, ZSW1)."""


class Report:
    """What an axis shows in a step. Positions and speeds are fractions of the references, those of a positioner LU and LU/min.

    One object for all steps of an executor: nothing keeps it. The executor uses one of the methods in all of them, so no value of
    the step before stays.
    """

    def __init__(self) -> None:
        self.raw: Sequence[int] = ()
        """Raw values of the objects of a transparent telegram, the Statusword first."""
        self.fill_motion(None)

    def fill(self, reason: Reason | None, flags: int = 0, speed: int = 0) -> Report:
        """Set what every axis shows; returns the record."""
        self.reason = reason
        """Why it does not follow the request."""
        self.flags = flags
        """Bits of ``Flag`` that only the executor knows."""
        self.speed = speed
        """Also of a positioner a fraction of the reference."""
        return self

    def fill_motion(
        self,
        reason: Reason | None,
        flags: int = 0,
        speed: int = 0,
        position: int = 0,
        length_speed: int = 0,
        active: int = 0,
        positioner: tuple[int, int] = (0, 0),
    ) -> Report:
        """Set everything but raw values; returns the record."""
        self.position = position
        self.length_speed = length_speed
        self.active = active
        """AKTSATZ of telegram 9: the homing method, and MDI active."""
        self.positioner = positioner
        """POS_ZSW1 and POS_ZSW2."""
        return self.fill(reason, flags, speed)


SHOWN_FAULT: Final = _ZSW1.bit("FAULT").mask
_READY: Final = _ZSW1.bit("READY_TO_SWITCH_ON").mask
_SWITCHED_ON: Final = _READY | _ZSW1.bit("READY_TO_OPERATE").mask
_OPERATING: Final = _SWITCHED_ON | _ZSW1.bit("OPERATION_ENABLED").mask

_SHOWN: dict[State | None, int] = {
    State.NOT_READY_TO_SWITCH_ON: 0,
    State.SWITCH_ON_DISABLED: _ZSW1.bit("SWITCHING_ON_INHIBITED").mask,
    State.READY_TO_SWITCH_ON: _READY,
    State.SWITCHED_ON: _SWITCHED_ON,
    State.OPERATION_ENABLED: _OPERATING,
    # Quick stop: bit 2 is 0 in ZSW1 although it is 1 in the Statusword.
    State.QUICK_STOP_ACTIVE: _SWITCHED_ON,
    State.FAULT_REACTION_ACTIVE: _OPERATING | SHOWN_FAULT,
    State.FAULT: SHOWN_FAULT,
    # Invalid Statusword: reported as a fault; the axis is being stopped.
    None: SHOWN_FAULT,
}
STATE_MASK: Final = len(STATE_OF_STATUS) - 1
"""The Statusword bits that show its state."""
SHOWN_STATE: Final = tuple(_SHOWN[state] for state in STATE_OF_STATUS)
"""Flags of the state (ZSW1 bits 0-3 and 6) by the Statusword's ``STATE_MASK``."""
SHOWN_UNCOMMANDED: Final = tuple(
    _SHOWN[State.QUICK_STOP_ACTIVE if state is State.OPERATION_ENABLED else state] for state in STATE_OF_STATUS
)
"""The same for uncommanded operation: the axis is being stopped with power on."""
