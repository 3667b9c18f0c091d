"""What the gateway watches of a device: what a device may do, what stops it, and after which time.

A sign that healthy devices show too only asks or informs; a proof stops. Source: docs/safety.md.
"""

from __future__ import annotations

import enum
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.bus.node_checks import CHECK_NS
from pdgw.ds301.node.node import NodeSettings
from pdgw.ds301.node.plan import PdoPlan
from pdgw.ds301.node.polled import FAILURES
from pdgw.ds301.node.polling import OLDEST_NS, POLL_NS
from pdgw.dsp402.modes import MODE_CONFIRM_NS
from pdgw.gateway.axis.executors.positions.handshake import ACKNOWLEDGE_NS as SETPOINT_NS
from pdgw.gateway.axis.settings import AxisSettings
from pdgw.gateway.axis.supervision.drive_events import ACKNOWLEDGE_NS, EMERGENCY_PATIENCE_NS
from pdgw.gateway.axis.supervision.polled_speed import ANSWERS
from pdgw.gateway.axis.supervision.stop_supervision import RAMP_MARGIN
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.motion.travel import LIMIT_LEFT_NS, LIMIT_STANDING_NS

_F = FaultNumber
_Limit = Callable[[NodeSettings, AxisSettings], int]


class Measured(enum.StrEnum):
    """Supervisions whose time ``pdgw axis test`` measures, by their names."""

    HEARTBEAT = "heartbeat"
    TPDO = "TPDO"
    SDO = "SDO answer"
    ENTERS = "entering operation"
    REACTS = "reaction to a command"
    LEAVES = "leaving operation at standstill"
    BRAKES = "ramp from 100 % speed"
    MODE = "change of the mode"
    ACKNOWLEDGE = "acknowledge of a fault"


@dataclass(frozen=True, slots=True)
class Supervision:
    """One check. ``name``: of what is measured."""

    name: str
    proof: str
    """What stops, or warns: with a limit, what is later than it."""
    reaction: str
    fault: FaultNumber | None
    """That of the gateway; None: it is the device's own."""
    sign: str = ""
    """What healthy devices show too, and what is done then; empty: the time until the limit is not noticed."""
    limit: _Limit | None = None
    """Longest time, in nanoseconds, with the settings of a node and of an axis; None: the check has no time."""
    key: str = ""
    """The configuration key that changes the limit; empty if nothing does."""


_LOST = "quick stop; the node is configured again"
_STOPS = "NMT stop, then no heartbeat"

SUPERVISIONS: Final = (
    Supervision(
        Measured.HEARTBEAT,
        "no heartbeat",
        _LOST,
        _F.NODE_LOST,
        "one that is early: a counter, and questions to the node",
        lambda node, _: node.heartbeat_limit_ns,
        "heartbeat_factor",
    ),
    Supervision(
        Measured.TPDO,
        "no frame of a TPDO",
        _LOST,
        _F.NODE_LOST,
        "a second one for a SYNC: a counter, and questions to the node",
        lambda node, _: node.tpdo_limit_ns,
        "tpdo_timeout_factor",
    ),
    Supervision(
        Measured.SDO,
        "no answer to an SDO request, while the node is configured",
        "ZSW1 fault; the node is tried again",
        _F.NODE_ABSENT,
        "a late answer: the time-out is doubled, up to 4 s, and the request repeated",
        lambda node, _: node.sdo_timeout_ms * MS,
        "sdo_timeout_ms",
    ),
    Supervision(
        "number of devices",
        "SDO requests answered twice, two NMT states in turns, two TPDOs for each SYNC, or two positions",
        "quick stop; the node is refused",
        _F.NODE_REFUSED,
        "early frames: questions to the node",
    ),
    Supervision(
        "restart",
        "a boot-up message in operation",
        _LOST,
        _F.NODE_RESTARTED,
        "one before it is online: the bring-up begins again",
    ),
    Supervision(
        "Statusword",
        "a Statusword without a state of CiA 402",
        "quick stop until the drive is off",
        _F.STATE_UNKNOWN,
        "reserved bits and those of the manufacturer are ignored",
    ),
    Supervision(
        "EMCY",
        "the Statusword shows a fault without an EMCY: number and code are read from the drive",
        "ZSW1 fault",
        None,
        "an EMCY without a fault: a warning",
        lambda _, __: EMERGENCY_PATIENCE_NS,
    ),
    Supervision(
        "following ON",
        "Switch On without Switched On",
        "ON is used up: OFF and ON",
        None,
        "a contactor closes, or the DC link is charged: Starting",
        lambda _, axis: axis.enter_ns,
        "enter_ms",
    ),
    Supervision(
        Measured.ENTERS,
        "Enable Operation without Operation Enabled",
        "Quick Stop, then as below",
        _F.NOT_ENTERED,
        "a brake opens, or the drive finds its commutation angle: Starting",
        lambda _, axis: axis.enter_ns,
        "enter_ms",
    ),
    Supervision(
        Measured.REACTS,
        "a stop command while the axis turns, and the Statusword has not left operation",
        _STOPS,
        _F.STOP_IGNORED,
        "",
        lambda _, axis: axis.reaction_ns,
        "tpdo_event_ms",
    ),
    Supervision(
        Measured.LEAVES,
        "a stop command at standstill, and the Statusword has not left operation",
        _STOPS,
        _F.STOP_IGNORED,
        "its brake closes: Stopping, ON is not accepted",
        lambda _, axis: axis.enter_ns,
        "enter_ms",
    ),
    Supervision(
        Measured.BRAKES,
        "the speed is above a line to standstill",
        _STOPS,
        _F.STOP_IGNORED,
        "a ramp that begins slowly or is longer than stop_time_ms",
        lambda _, axis: axis.reaction_ns + RAMP_MARGIN * axis.stop_time_ns,
        "stop_time_ms",
    ),
    Supervision(
        "speed without power",
        "the drive reports power off, and its speed does not fall",
        "warning",
        _F.TURNS_OFF,
        "the axis runs down",
        lambda _, axis: axis.reaction_ns + RAMP_MARGIN * axis.stop_time_ns,
        "stop_time_ms",
    ),
    Supervision(
        Measured.MODE,
        "6061h does not show the mode of 6060h",
        "warning",
        _F.MODE_NOT_CONFIRMED,
        "waits, no setpoint",
        lambda _, __: MODE_CONFIRM_NS,
    ),
    Supervision(
        "acknowledge of a setpoint",
        "Statusword.12 does not follow Controlword.4",
        "warning",
        _F.NOT_ACKNOWLEDGED,
        "the setpoint is kept",
        lambda _, __: SETPOINT_NS,
    ),
    Supervision(
        Measured.ACKNOWLEDGE,
        "the drive is still in fault",
        "ZSW1 fault stays; another edge of STW1.7 is needed",
        None,
        "",
        lambda _, __: ACKNOWLEDGE_NS,
    ),
    Supervision(
        "internal limit",
        "Statusword.11 at standstill with a setpoint, longer if it was there before the motion",
        "Target Velocity 0 and a warning",
        _F.INTERNAL_LIMIT,
        "at rest, at the commanded speed and during a homing it is a note",
        lambda _, __: LIMIT_LEFT_NS,
    ),
    Supervision(
        "internal limit of the speed",
        "Statusword.11, slower than the setpoint",
        "warning",
        _F.INTERNAL_LIMIT,
        "",
        lambda _, __: LIMIT_STANDING_NS,
    ),
    Supervision(
        "speed and position",
        "606Ch and 6064h differ by more than a factor of 5, or 606Ch is above 150 % of the setpoint",
        "quick stop until an acknowledge",
        _F.VELOCITY,
        "a factor of 1.25: warning 115. A wrap at 607Bh or at the end of the numbers and a jump are ignored",
    ),
    Supervision(
        "standstill before the target",
        "the axis makes no way, and Statusword.10 does not come",
        "warning",
        _F.STALLED,
        "Statusword.10 may come later than standstill",
        lambda _, axis: axis.stall_ns,
    ),
    Supervision(
        "motion without a task",
        "the axis turns with Halt, outside the standstill window",
        "Halt again and a warning",
        _F.MOVES_UNASKED,
        "CiA 402 allows a drive to continue when Halt falls: Halt again",
    ),
)


def speed_by_sdo(plan: PdoPlan, node: NodeSettings, reaction_ns: int) -> tuple[str, ...]:
    """For the user: how late standstill and faults are seen of a drive whose speed has no TPDO; nothing for other drives."""
    sent = {name for item in plan.tpdos for name in item.pdo.attributes}
    entry = next(
        (item for item in plan.read if item.attribute == "velocity_actual" and item.attribute not in sent), None
    )
    if entry is None:
        return ()
    times = ANSWERS * (POLL_NS + CHECK_NS) / SECOND, (ANSWERS + 1) * OLDEST_NS / SECOND
    reaction, lost = reaction_ns / SECOND, FAILURES * (POLL_NS / SECOND + node.sdo_timeout_ms * MS / SECOND)
    at_once, late = (f"standstill {time:.3g} s, fault 125 {time + reaction:.3g} s" for time in times)
    return (
        f"the only speed is {entry.index:04X}h by SDO. Longest time from a stop to what is seen of it, with answers at once: "
        f"{at_once}; with answers that take 1 s: {late}. Without answers the drive is lost after {lost:.3g} s",
    )
