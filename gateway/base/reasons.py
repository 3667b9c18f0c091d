"""The reasons why the gateway does not follow the PLC: one table, with what follows from each; and the record of a reason.

Translators report them; ``pdgw status``, the log, P947 and the timeline show them. A text says what happened and what the PLC
must do. Source: docs/translation.md.
"""

from __future__ import annotations

import enum
from typing import Final, NamedTuple

from pdgw.gateway.base.fault_numbers import CHECK_UNITS, By
from pdgw.gateway.base.steps import (
    ACKNOWLEDGE,
    NEW_TASK,
    OFF_ON,
    STANDSTILL,
    Acknowledge,
    Bits,
    Edge,
    Give,
    Remedy,
    Step,
    Wait,
)


class AxisState(enum.Enum):
    """State of a drive object for the user; ``value`` is the word shown everywhere."""

    OBEYS = "In operation"
    """The drive follows the PLC's setpoints."""
    OFF = "Off"
    """As the PLC asks."""
    STARTING = "Starting"
    WAITS = "Waits"
    """Something is missing: the reason says what."""
    STOPPING = "Stopping"
    FAULT = "Fault"
    NOT_ON_THE_BUS = "Not on the bus"


class Enable(enum.Enum):
    """A link of the chain of enables, the physical ones first, then the drive, then the PLC's program."""

    BUS = "CAN bus"
    NODE = "device on the bus"
    SUPPLY = "supply voltage"
    NO_FAULT = "no fault"
    SENSOR = "sensor in operation"
    OPERATION = "drive follows ON"
    PLC = "PLC frames"
    CONTROL = "control by PLC"
    ON_EDGE = "ON command accepted"
    SETPOINT = "setpoint enabled"


_S, _E = AxisState, Enable


class Reason(enum.Enum):
    """A standing reason, declared with what follows from it; ``value`` is the text for the user."""

    _value_: str
    head: str
    """The text without the bits that give it, where it names bits."""
    code: int
    """Its place, 1 for the first: recordings have the names in this order. 0 is left for the absence of a reason."""
    state: AxisState
    """State of the object with this reason, unless power is on and it is being stopped."""
    enable: Enable
    """The link of the chain it breaks."""
    remedy: Remedy
    past: str
    """The text when it is over and ON is still ignored; empty: ``value`` stays true."""

    def __new__(
        cls,
        text: str | tuple[str, str],
        steps: Step | Remedy,
        enable: Enable = Enable.SETPOINT,
        state: AxisState = AxisState.WAITS,
        past: str = "",
    ) -> Reason:
        member = object.__new__(cls)
        member._value_ = text if isinstance(text, str) else ": ".join(text)
        member.head = text if isinstance(text, str) else text[0]
        member.code = len(cls.__members__) + 1
        member.state, member.enable, member.past = state, enable, past
        member.remedy = (steps,) if isinstance(steps, Step) else steps
        return member

    NO_PLC = (
        "no valid frame from the PLC yet: Controlword stays 0",
        "bring the PLC to RUN; check its target address and port, and that its frames have the bytes of pdgw map",
        _E.PLC,
    )
    PLC_LOST = (
        "PLC lost: the gateway stops the drive; ON is accepted again only after an OFF (STW1.0 = 0)",
        ("check the cable, the PLC's operating mode (STOP) and its cycle time", OFF_ON),
        _E.PLC,
    )
    NO_CONTROL = (
        "STW1.10 = 0 (control by PLC): the drive does not start and ignores setpoints; OFF1, OFF2 and OFF3 act",
        Bits(("STW1.10",)),
        _E.CONTROL,
    )
    NEEDS_OFF = (
        "ON ignored: send an OFF first (STW1.0 = 0 with STW1.1 = STW1.2 = 1)",
        OFF_ON,
        _E.ON_EDGE,
    )
    DRIVE_OFFLINE = (
        "drive is not online: the gateway sends no command",
        "check power, CAN cable, termination, bit rate and node-ID of the drive",
        _E.NODE,
        _S.NOT_ON_THE_BUS,
    )
    DRIVE_FAULT = (
        "the drive is in fault",
        ("remove the cause", ACKNOWLEDGE),
        _E.NO_FAULT,
        _S.FAULT,
    )
    DRIVE_UNKNOWN_STATE = (
        "the Statusword matches no state of CiA 402: the gateway stops the drive",
        "check the device and its PDO mapping: the Statusword is not a CiA 402 state",
        _E.NO_FAULT,
        _S.FAULT,
    )
    REFERENCE_INVALID = (
        "100 % of the speed is unknown, the drive lacks the mode of operation, or an object of it acts against the telegram "
        "(fault 104 names the key or the object)",
        "set the key or the object that fault 104 names, see pdgw config check --bus",
        _E.NO_FAULT,
        _S.FAULT,
    )
    RAMP_STOP = (
        "OFF1 ramp in progress: ON is accepted at standstill",
        (STANDSTILL, OFF_ON),
        _E.ON_EDGE,
        _S.STOPPING,
        "ON came before the end of the OFF1 ramp",
    )
    QUICK_STOP = (
        "quick stop in progress",
        (STANDSTILL, OFF_ON),
        _E.ON_EDGE,
        _S.OFF,
        "the PLC has sent OFF3 (STW1.2 = 0)",
    )
    COAST_STOP = (
        ("coast stop", "STW1.1 = 0"),
        OFF_ON,
        _E.ON_EDGE,
        _S.OFF,
        "the PLC has sent OFF2 (STW1.1 = 0)",
    )
    SETPOINT_DISABLED = (
        ("no setpoint", "STW1.4, STW1.5 or STW1.6 is 0"),
        Bits(("STW1.4", "STW1.5", "STW1.6")),
    )
    INTERNAL_LIMIT = (
        ("the drive itself limits the motion (Statusword.11 = 1)", "limit switch, position or speed limit"),
        "check limit switches and the drive's own limits; move away from them",
    )
    STOPPED_AT_LIMIT = (
        "stopped at a limit of the drive (Statusword.11)",
        Give(
            "other direction",
            "send a setpoint in the other direction; after the limit is free, setpoint 0 (or OFF and ON) ends this stop",
        ),
    )
    TASK_AT_LIMIT = (
        "task stopped at a limit of the drive (Statusword.11)",
        Give(
            "other direction",
            "send a task in the other direction; after the limit is free, STW1.5 = 0 and 1 continues the task",
        ),
    )
    SET_POINT_REFUSED = (
        "the drive rejected the data of the setpoint (SDO): not started, needs a new edge",
        ("see fault 119 for the value that the drive rejects", NEW_TASK),
    )
    NOT_OPERATING = (
        "drive is not in operation: setpoints have no effect",
        "check the drive's own enables: safe torque off (STO), enable input, limit switches",
        _E.OPERATION,
        _S.STARTING,
    )
    MODE_NOT_CONFIRMED = (
        "waiting for the drive to confirm the mode of operation (6061h)",
        "use a drive that supports the mode of operation of this telegram",
        _E.OPERATION,
    )
    MODE_VALUE = (
        "the drive does not support this mode of operation: the gateway does not send it",
        Give("6060h", "send a mode of operation that the drive supports"),
    )
    MDI_OFF = (
        "SATZANW.15 = 0: MDI is not selected, no traversing task is started",
        Bits(("SATZANW.15",)),
    )
    REJECTED = (
        "STW1.4 = 0: tasks are rejected, and nothing starts",
        STANDSTILL,
    )
    INTERMEDIATE_STOP = (
        "STW1.5 = 0: intermediate stop",
        Bits(("STW1.5",)),
    )
    HOMING_METHOD = (
        "homing method is not supported: homing is not started",
        ("set a homing_method that the drive supports; fault 108 lists them", Edge(("STW1.11",))),
    )
    HOMING_SETUP = (
        "waiting for the drive to accept homing method and speeds (SDO)",
        Wait("less than a second"),
    )
    HOMING_STOPPED = (
        "STW1.11 = 0: homing is being stopped",
        STANDSTILL,
    )
    HOMING_ERROR = (
        "the drive reports a homing error (Statusword.13) or does not reach its home position",
        ("check the home switch and the homing speeds", Edge(("STW1.11",))),
    )
    FUNCTION_RUNS = (
        "an edge of STW1.6, .8, .9 or .11 came while another function of the positioner was active: it started nothing",
        (Give("active function", "end the active function"), Edge(("STW1.6", "STW1.8", "STW1.9", "STW1.11"))),
    )
    TASK_BLOCK_UNKNOWN = (
        "the task selected a traversing block that does not exist: it was not started",
        (Give("BLOCK", "select a block of the configuration"), NEW_TASK),
    )
    TASK_SPEED_ZERO = (
        "the task had speed 0: it was not started",
        (Give("MDI_VELOCITY", "give the task a speed above 0"), NEW_TASK),
    )
    TASK_TARGET_RANGE = (
        "the target of the task was out of range: it was not started",
        (Give("MDI_TARPOS", "give a target in range"), NEW_TASK),
    )
    TASK_DIRECTION = (
        "setting up needs exactly one bit of direction, a modulo axis at most one: the task was not started",
        (Give("direction", "set one of POS_STW1.9 and .10 (telegram 110: MDI_MOD.1 and .2)"), NEW_TASK),
    )
    UPDATE_RELATIVE = (
        "continuous update needs absolute positions: the change had no effect",
        (Give("ABSOLUTE", "select absolute positioning"), NEW_TASK),
    )
    OVERRIDE_ZERO = (
        "OVERRIDE is 0: the task waits",
        Give("OVERRIDE", "raise OVERRIDE"),
    )
    SOFTWARE_LIMIT = (
        "target is beyond a software limit: the limit is the target",
        (Give("MDI_TARPOS", "give a target inside the software limits"), NEW_TASK),
    )
    FLYING_NOT_SUPPORTED = (
        "the drive has no second setpoint buffer: the block continues with a stop",
        "use blocks that stop, or a drive with a second setpoint buffer",
    )
    TORQUE_LIMIT = (
        "torque limit 6072h is being written, or the drive rejected it",
        (Wait(""), "if it stays, read the fault of the axis"),
    )
    FIXED_STOP_MISSED = (
        "no fixed stop before the target of the block",
        "check the mechanics and the target of the block",
    )
    PASSIVE_HOMING_NOT_SUPPORTED = (
        "the drive has no touch probe (60B8h): passive homing is not possible",
        "use active homing",
    )
    REFERENCE_POINT_MOVING = (
        "the reference point was not set: the axis moved, or a task was active",
        (
            Give("active function", "end the active function"),
            STANDSTILL,
            Edge(("POS_STW2.1 (telegram 110: POS_STW.1)",)),
        ),
    )
    DSC_FAR_FROM_AXIS = (
        "DSC starts too far from the actual position (following_window): the axis does not move",
        Give("XERR", "copy the actual position of the axis to the PLC's setpoint before DSC starts"),
    )
    DSC_OUT_OF_DATE = (
        "no new XERR from the PLC for too long: the axis stops with a ramp, then DSC starts again",
        "check the PLC's cycle time and why its frames are late; DSC tolerates a shorter gap than the watchdog",
    )
    ENCODER_NO_PLC = (
        "no valid frame from the PLC: the encoder receives no request",
        "bring the PLC to RUN; check its target address and port, and that its frames have the bytes of pdgw map",
        _E.PLC,
    )
    ENCODER_NO_CONTROL = (
        "STW2_ENC.10 = 0 (control by PLC): G1_STW is not evaluated",
        Bits(("STW2_ENC.10",)),
        _E.CONTROL,
    )
    ENCODER_OFFLINE = (
        "encoder is not online: its position is not valid",
        "check power, CAN cable, termination, bit rate and node-ID of the encoder",
        _E.NODE,
        _S.NOT_ON_THE_BUS,
    )
    SENSOR_ERROR = (
        "sensor error, code in G1_XIST2: acknowledge with a rising edge of G1_STW.15",
        ("remove the cause", Acknowledge("G1_STW.15", "STW2_ENC.10")),
        _E.NO_FAULT,
        _S.FAULT,
    )
    SENSOR_PARKED = (
        "G1_STW.14 = 1: sensor is parked",
        Bits(("G1_STW.14",), 0),
        _E.SENSOR,
        _S.OFF,
    )
    SENSOR_PRESETTING = (
        "waiting for the encoder to accept and show the preset",
        Wait("some seconds"),
        _E.SENSOR,
        _S.STARTING,
    )
    UNITS_CONTRADICTED = (
        "the speed contradicts the units of the drive (fault 128): stopped, ON is ignored until an acknowledgement",
        (CHECK_UNITS, ACKNOWLEDGE, OFF_ON),
        _E.NO_FAULT,
        _S.FAULT,
    )
    BUS_LOST = (
        "the CAN bus is lost: bus-off, or no interface",
        "check CAN cable, termination, bit rate and the interface; the gateway connects again by itself",
        _E.BUS,
        _S.NOT_ON_THE_BUS,
    )
    NODE_REFUSED = (
        "the gateway rejects the device: it is not the configured device, or it does not accept its configuration",
        "compare the device with the configuration, see pdgw config check --bus",
        _E.NODE,
        _S.NOT_ON_THE_BUS,
    )
    NODE_CONFIGURING = (
        "the device is being configured",
        Wait("until every object is read and written; a slow device needs minutes"),
        _E.NODE,
        _S.STARTING,
    )
    NO_SUPPLY = (
        "the drive reports no supply voltage (Statusword.4 = 0)",
        "check main contactor, emergency stop and the supply of the power stage",
        _E.SUPPLY,
    )
    SWITCHED_OFF = (
        "the PLC has switched the drive off (STW1.0 = 0)",
        "no error: ON (STW1.0 = 1) switches the drive on",
        _E.ON_EDGE,
        _S.OFF,
    )
    ENABLE_MISSING = (
        ("the PLC does not enable operation", "STW1.3 = 0"),
        Bits(("STW1.3",)),
        _E.ON_EDGE,
    )
    PLC_STALLED = (
        "the PLC's sign of life (STW2.12-15) does not count with each frame: its program is stopped or too slow",
        ("check the PLC's program; count in the clock of the frames, or raise P925", OFF_ON),
        _E.PLC,
    )
    GATEWAY_STOPS = (
        "the gateway is being stopped",
        "start the gateway again",
        _E.PLC,
        _S.STOPPING,
    )
    NOT_ACKNOWLEDGED = (
        "the drive did not acknowledge the setpoint (Statusword.12 = 0): it may not execute the task",
        ("check that 6061h of the drive keeps the mode of operation", NEW_TASK),
    )
    MOVES_UNASKED = (
        "the drive continued a stopped task when Halt fell: Halt stays set until the next task",
        Give("task", "send the next task; its first cycle may move the axis towards the old target"),
    )
    NODE_WRITTEN = (
        "a write changed units or settings of the device: the gateway checks them before the next start",
        (Wait("less than a second"), OFF_ON),
        _E.NODE,
        _S.STARTING,
    )
    TASK_RAMP_ZERO = (
        "the task had acceleration or deceleration 0: it was not started",
        (Give("MDI_ACC", "give the task an acceleration and a deceleration above 0"), NEW_TASK),
    )
    NOT_REACHED = (
        "the axis is at standstill before its target: Statusword.10 = 0",
        "check whether the axis is blocked, its brake, and the torque limit and the position window (6067h) of the drive",
    )
    FOLLOWING_ERROR = (
        "the axis is at standstill before its target: following error of the drive (Statusword.13 = 1)",
        "check whether the axis is blocked, its brake, and the torque limit of the drive",
    )
    STANDS_AWAY = (
        "the drive reports its target as reached (Statusword.10 = 1), but is away from the target of the task",
        ("check the software limits (607Dh) and the units of the drive", NEW_TASK),
    )
    SETPOINT_BLOCKED = (
        "the drive does not take a new setpoint: it still acknowledges the last one (Statusword.12 = 1)",
        (OFF_ON, "if it stays, check the drive: Statusword.12 must fall with Controlword.4"),
    )
    HOMING_STALLED = (
        "the axis is at standstill, and its homing does not end (Statusword.10 = Statusword.12 = 0)",
        "check whether the axis is blocked, its brake, and the home switch; STW1.11 = 0 ends the homing",
    )
    INHIBITED = (
        "the drive has not followed ON in time: safe torque off (STO), enable input or supply; ON is used up",
        ("close STO and the enable input, switch the supply on", OFF_ON),
        _E.OPERATION,
    )
    HELD_OFF = (
        ("the PLC sends ON (STW1.0 = 1) and keeps the drive off", "STW1.1, STW1.2 and STW1.3 must be 1 too"),
        (Bits(("STW1.1", "STW1.2", "STW1.3")), OFF_ON),
        _E.ON_EDGE,
    )
    HOMING_REFUSED = (
        "the drive rejects the homing method or its speeds (fault 111): homing is not started",
        "choose a homing_method that the drive supports (6098h, 60E3h) and speeds inside its limits (6099h)",
    )
    FRAME_LAYOUT = (
        "the PLC's frames have another layout: another telegram, or another number of axes",
        "give the PLC the layout that pdgw map prints, or set the telegram of each axis to that of the PLC",
        _E.PLC,
    )
    FRAME_INVALID = (
        "the PLC's frames are not valid: FrameID or DataStatus",
        "the PLC must send FrameID and DataStatus as pdgw map prints them",
        _E.PLC,
    )
    FRAME_TICK = (
        "the PLC's frames are without a tick of this gateway",
        "the PLC must receive the gateway's frames and copy the tick of the newest one (docs/plc.md)",
        _E.PLC,
    )
    FRAME_OLD = (
        "the PLC's frames are older than twice the watchdog time",
        "raise watchdog_factor; if the age rises steadily, the PLC must read all waiting frames in each scan",
        _E.PLC,
    )
    FRAME_COUNTER = (
        "the cycle counter of the PLC's frames does not increase",
        "the PLC must raise the cycle counter with each frame (docs/plc.md)",
        _E.PLC,
    )
    PLC_STOP = (
        "the PLC is in STOP: its frames come, but the provider state is not RUN",
        ("set the PLC to RUN", OFF_ON),
        _E.PLC,
        _S.WAITS,
        "the PLC was in STOP",
    )
    PLC_BAD = (
        "the PLC marks its data for this drive object as bad (IOPS)",
        ("the PLC must set the IOPS of this drive object to 80h, at its place in pdgw map", OFF_ON),
        _E.PLC,
        _S.WAITS,
        "the PLC marked its data for this drive object as bad (IOPS)",
    )
    OTHER_SENDER = (
        "frames of another sender than the PLC do not count",
        "switch the other sender off, or give it another gateway",
        _E.PLC,
    )
    WATCHDOG_SHORT = (
        "the PLC is lost repeatedly: its frames come later than the watchdog time",
        ("raise cycle_time_ms or watchdog_factor, or find what delays the PLC's frames", OFF_ON),
        _E.PLC,
    )
    NO_RELATIONSHIP = (
        "the PROFINET controller has no relationship with this drive object",
        "compare name of station, modules and telegrams of the controller's project with pdgw map",
        _E.PLC,
    )
    MODE_KEPT = (
        "the drive does not change its mode of operation while it is in operation (6061h)",
        "end the request; then check whether the drive has this mode (6502h) and changes it in Operation Enabled",
        _E.OPERATION,
    )
    LOST_EDGE = (
        "the last edge of STW1.6 started no task",
        NEW_TASK,
    )
    EARLY_EDGE = (
        "STW1.6 was 1 before operation: this starts no task",
        NEW_TASK,
    )
    LOST_HOMING = (
        "STW1.11 = 1 starts no homing",
        Edge(("STW1.11",)),
    )
    LOST_JOG = (
        "STW1.8 or STW1.9 = 1 starts no jog",
        Edge(("STW1.8", "STW1.9")),
    )
    BYTES_SWAPPED = (
        "the two bytes of STW1 are swapped",
        "swap the bytes of each word in the PLC's program: PROFIdrive sends the high byte first",
        _E.CONTROL,
    )
    CONTROL_HELD = (
        'STW1.10 = 0 (control by PLC): the drive continues with its last setpoint (control_lost = "hold")',
        Bits(("STW1.10",)),
        _E.CONTROL,
    )
    ENCODER_FAULT = (
        "the encoder is in fault (ZSW2_ENC.3 = 1)",
        ("remove the cause", Acknowledge("STW2_ENC.7", "STW2_ENC.10")),
        _E.NO_FAULT,
        _S.FAULT,
    )
    TASK_VELOCITY = (
        "velocity x OVERRIDE of the task was below 100 %, the only velocity of this drive (no 6081h)",
        (
            Give("MDI_VELOCITY", "set the velocity of the task to 100 % (max_velocity) and OVERRIDE to 4000h (100 %)"),
            NEW_TASK,
        ),
    )
    NOT_LEFT = (
        "the drive is at standstill and has not left operation yet",
        (
            Wait("while its brake closes"),
            "if it takes longer than enter_ms (10 s), check the brake and its time in the drive",
        ),
        _E.OPERATION,
        _S.STOPPING,
    )
    TASK_DRIVE_RANGE = (
        "the positions of the drive end before the target of the task: it was not started",
        (
            Give("MDI_TARPOS", "give a target before this end"),
            NEW_TASK,
            "an endless axis needs 607Bh = 0/0, or a drive that wraps at 607Bh",
        ),
    )
    AT_SOFTWARE_LIMIT = (
        "the axis is at a software limit, and its jog, setting up or endless block leads beyond it",
        Give("other direction", "move in the other direction; the limits are the key software_limits"),
    )
    SEVERE_FAULT = (
        "a severe fault is not acknowledged",
        ("remove the cause", ACKNOWLEDGE),
        _E.NO_FAULT,
        _S.FAULT,
    )
    LOCAL_MODE = (
        ("the drive takes no commands from the bus", "local mode (Statusword.9 = 0)"),
        "switch the drive to remote at its panel or in its tool",
        _E.OPERATION,
        _S.WAITS,
        "ON came while the drive was in local mode (Statusword.9 = 0)",
    )
    LOCAL_TURNS = (
        ("the shaft turns by the drive's panel or tool, not by the gateway", "local mode (Statusword.9 = 0)"),
        "stop the drive at its panel or in its tool, and switch it to remote",
        _E.OPERATION,
        _S.FAULT,
    )
    JOG_WAITS = (
        "STW1.8 or STW1.9 = 1: the axis turns, and a jog starts at standstill",
        STANDSTILL,
    )
    NO_JOG_SPEED = (
        "STW1.8 or STW1.9 = 1 starts no jog: it has no speed in jog_speeds_rpm",
        (Bits(("STW1.8", "STW1.9"), 0), 'or configure jog_speeds_rpm with setpoint_enable = "profidrive"'),
    )
    LAGS = (
        "the axis does not follow its setpoint",
        ("check brake, torque limit and mechanics",),
        _E.SETPOINT,
        _S.OBEYS,
    )
    HOME_LOST = (
        "an absolute task runs without a home position",
        "stop the task, and home the axis before an absolute task",
        _E.SETPOINT,
        _S.OBEYS,
    )


REFUSED_ORDERS: Final = (
    Reason.REFERENCE_POINT_MOVING,
    Reason.TASK_BLOCK_UNKNOWN,
    Reason.TASK_SPEED_ZERO,
    Reason.TASK_RAMP_ZERO,
    Reason.TASK_TARGET_RANGE,
    Reason.TASK_DRIVE_RANGE,
    Reason.TASK_DIRECTION,
    Reason.TASK_VELOCITY,
    Reason.UPDATE_RELATIVE,
    Reason.FUNCTION_RUNS,
)
"""Orders that were refused: each has the time of its warning 113."""


class Finding(NamedTuple):
    """Why something is not as it was asked: of the PLC's frames, of a link of the chain of enables, of what began a stop.

    Times are monotonic nanoseconds. ``finding_text`` has its text.
    """

    reason: Reason
    evidence: str
    remedy: Remedy
    node: int = 0
    """Node-ID that the evidence is about and its text begins with; 0: none."""
    since_ns: int | None = None
    """When it began; None: its text has no time."""
    until_ns: int | None = None
    """When it was over, and only OFF and ON are missing; None: it is not, or its end does not matter."""
    times: int = 0
    """How often its fault was reported."""
    more: str = ""
    """What follows the time."""
    by: By = By.GATEWAY
    number: int = 0
    """Its fault (P947); 0: no fault."""
    code: int = 0
    """The code of it (P945)."""
    last_ns: int | None = None
    """When it was reported last; None: it is not a fault."""
    ended: str = ""
    """Of a start: how the last gateway ended,"""
    before: str = ""
    """and what had stopped the drive object then."""

    @classmethod
    def of(cls, reason: Reason, evidence: str = "", place: str = "") -> Finding:
        """Those of the reason, where nothing is known that says more. ``place``: where to look."""
        return cls(reason, evidence or reason.value, (place,) if place else reason.remedy)

    @property
    def period(self) -> tuple[int, int]:
        """Its first and its last time, both the same of what has only one. ValueError without a time."""
        times = [time for time in (self.since_ns, self.last_ns) if time is not None]
        return min(times), max(times)
