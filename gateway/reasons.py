"""Why the gateway does not do what the PLC asks, and the gateway's own fault numbers: two tables.

Translators report these, ``pdgw status``, the log, P947 and the timeline decoder print them. Texts say what happened
and what the PLC has to do. Source: docs/translation.md.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from types import MappingProxyType


class Reason(enum.Enum):
    """A standing reason; ``value`` is the text for the user."""

    NO_PLC = "no valid frame from the PLC yet: Controlword stays 0"
    PLC_LOST = "PLC lost: the drive is being stopped; ON is obeyed again only after an OFF (STW1.0 = 0)"
    NO_CONTROL = "STW1.10 = 0 (control by PLC): nothing starts, setpoints are not evaluated; OFF1, OFF2 and OFF3 act"
    NEEDS_OFF = "ON ignored: needs OFF first (STW1.0 = 0 with STW1.1 = STW1.2 = 1)"
    DRIVE_OFFLINE = "drive is not online: no command is sent"
    DRIVE_FAULT = "drive is in fault: acknowledge with a rising edge of STW1.7"
    DRIVE_UNKNOWN_STATE = "Statusword fits no state of the drive: stopping"
    REFERENCE_INVALID = (
        "the drive does not tell what 100 % is, or lacks the mode (fault 104 says what settles it): refused"
    )
    RAMP_STOP = "OFF1 ramp stop in progress: ON is not obeyed before standstill"
    QUICK_STOP = "quick stop in progress"
    COAST_STOP = "STW1.1 = 0: coast stop"
    SETPOINT_DISABLED = "no setpoint: STW1 bits 4, 5 and 6 must all be 1"
    INTERNAL_LIMIT = "the drive limits the motion by itself (Statusword.11: limit switch, position or speed limit)"
    STOPPED_AT_LIMIT = (
        "stood at a limit of the drive: setpoint 0 until the PLC takes its setpoint through 0, or OFF and ON"
    )
    TASK_AT_LIMIT = (
        "task stands at a limit of the drive: needs an intermediate stop (STW1.5 = 0, 1), a new task or a reject"
    )
    SET_POINT_REFUSED = "the drive did not take the data of the set-point (SDO): not started, needs a new edge"
    NOT_OPERATING = "drive is not in operation: setpoints have no effect"
    MODE_NOT_CONFIRMED = "waiting for the drive to confirm the mode of operation (6061h)"
    MODE_VALUE = "mode of operation is not one the drive knows: not passed on"
    MDI_OFF = "SATZANW.15 = 0: MDI is not selected, no traversing task is started"
    REJECTED = "STW1.4 = 0: traversing task rejected"
    INTERMEDIATE_STOP = "STW1.5 = 0: intermediate stop"
    HOMING_METHOD = "homing method is not supported: homing is not started"
    HOMING_SETUP = "waiting for the drive to take homing method and speeds (SDO)"
    HOMING_STOPPED = "STW1.11 = 0: homing is being stopped"
    HOMING_ERROR = "the drive reports a homing error (Statusword.13) or does not reach its home position"
    FUNCTION_RUNS = "another function of the positioner runs: it has to end first"
    TASK_BLOCK_UNKNOWN = "traversing block does not exist: nothing moves"
    TASK_SPEED_ZERO = "speed of the task is 0: nothing moves"
    TASK_TARGET_RANGE = "target of the task is out of range: nothing moves"
    TASK_DIRECTION = "setting up needs exactly one direction (POS_STW1.9 or .10): nothing moves"
    UPDATE_RELATIVE = "continuous update needs absolute positions: nothing changes"
    OVERRIDE_ZERO = "OVERRIDE is 0: task is kept"
    SOFTWARE_LIMIT = "target is beyond a software limit: the limit is the target"
    FLYING_NOT_SUPPORTED = "the drive keeps no second set-point: the block continues with a stop"
    FIXED_STOP_MISSED = "no fixed stop before the target of the block"
    PASSIVE_HOMING_NOT_SUPPORTED = "the drive has no touch probe (60B8h): no passive homing"
    REFERENCE_POINT_MOVING = "a reference point is set at standstill and without a task only"
    DSC_FAR_FROM_AXIS = "DSC starts too far from the actual position (following_window): axis stands"
    ENCODER_NO_PLC = "no valid frame from the PLC: nothing is requested of the encoder"
    ENCODER_NO_CONTROL = "STW2_ENC.10 = 0 (control by PLC): G1_STW is not evaluated"
    ENCODER_OFFLINE = "encoder is not online: its position is not valid"
    SENSOR_ERROR = "sensor error, code in G1_XIST2: acknowledge with a rising edge of G1_STW.15"
    SENSOR_PARKED = "G1_STW.14 = 1: sensor is parked"
    SENSOR_PRESETTING = "waiting for the encoder to take the preset (SDO)"


class FaultNumber(enum.IntEnum):
    """Numbers of the gateway's own faults and warnings (P947); from 101 on they keep clear of the manufacturer's 1-12."""

    NODE_LOST = 101
    BUS_LOST = 102
    PLC_LOST = 103
    REFERENCE = 104
    NODE_RESTARTED = 105
    NODE_REFUSED = 106
    STATE_UNKNOWN = 107
    HOMING_METHOD = 108
    HOMING = 109
    MODE_NOT_CONFIRMED = 110
    HOMING_PARAMETERS = 111
    INTERNAL_LIMIT = 112
    POSITIONER = 113
    DSC_GAIN = 114
    PRESET = 118
    SET_POINT = 119
    CONTROL_LOST = 120
    NODE_ABSENT = 121
    LEFT_OPERATION = 122
    OTHER_MASTER = 123
    SIGN_OF_LIFE = 124
    STOP_IGNORED = 125
    FRAME_CHANGED = 127


FIRST_WARNING = 108
"""Number of the warning with bit 0 of P953; the others follow."""


@dataclass(frozen=True, slots=True)
class GatewayFault:
    """A fault the gateway itself raises: P947 number, P945 code, warning or fault."""

    number: int
    name: str
    code: int
    is_warning: bool = False

    @property
    def warning_mask(self) -> int:
        """The bit of a warning in P953; 0 for a fault."""
        return 1 << (self.number - FIRST_WARNING) if self.is_warning else 0


GATEWAY_FAULTS: MappingProxyType[int, GatewayFault] = MappingProxyType(
    {
        fault.number: fault
        for fault in (
            GatewayFault(FaultNumber.NODE_LOST, "node lost (heartbeat or TPDO time-out)", 0x8130),
            GatewayFault(FaultNumber.BUS_LOST, "CAN bus-off or CAN interface lost", 0x8140),
            GatewayFault(FaultNumber.PLC_LOST, "PLC lost", 0xFF01),
            GatewayFault(FaultNumber.REFERENCE, "100 % or mode of the drive not known", 0xFF02),
            GatewayFault(FaultNumber.NODE_RESTARTED, "node restarted during operation", 0xFF03),
            GatewayFault(FaultNumber.NODE_REFUSED, "node identity or configuration refused", 0xFF04),
            GatewayFault(FaultNumber.STATE_UNKNOWN, "drive state unknown", 0xFF05),
            GatewayFault(FaultNumber.HOMING_METHOD, "homing method not supported", 0xFF06, is_warning=True),
            GatewayFault(FaultNumber.HOMING, "homing error", 0xFF07, is_warning=True),
            GatewayFault(FaultNumber.MODE_NOT_CONFIRMED, "mode of operation not confirmed", 0xFF08, is_warning=True),
            GatewayFault(
                FaultNumber.HOMING_PARAMETERS, "drive did not take the homing parameters", 0xFF09, is_warning=True
            ),
            GatewayFault(FaultNumber.INTERNAL_LIMIT, "internal limit of the drive reached", 0xFF0A, is_warning=True),
            GatewayFault(FaultNumber.POSITIONER, "positioner: task refused or changed", 0xFF0B, is_warning=True),
            GatewayFault(FaultNumber.DSC_GAIN, "gain of DSC limited", 0xFF0C, is_warning=True),
            GatewayFault(FaultNumber.PRESET, "encoder did not take the preset", 0xFF0F, is_warning=True),
            GatewayFault(FaultNumber.SET_POINT, "drive did not take the data of a set-point", 0xFF10, is_warning=True),
            GatewayFault(FaultNumber.CONTROL_LOST, "control by PLC taken away in operation", 0xFF15, is_warning=True),
            GatewayFault(FaultNumber.NODE_ABSENT, "node does not answer", 0xFF11),
            GatewayFault(FaultNumber.LEFT_OPERATION, "drive left operation by itself", 0xFF12),
            GatewayFault(FaultNumber.OTHER_MASTER, "another master on the bus", 0xFF13),
            GatewayFault(FaultNumber.SIGN_OF_LIFE, "sign of life of the PLC lost", 0xFF14),
            GatewayFault(FaultNumber.STOP_IGNORED, "drive does not obey a stop", 0xFF16),
            GatewayFault(FaultNumber.FRAME_CHANGED, "frame of the PLC changed by P922", 0xFF17),
        )
    }
)
"""Every fault and warning of the gateway by its number."""
