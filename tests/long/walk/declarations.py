"""What the walk treats apart in the axis machine: attributes that are not plain state, by class.

| declaration | attributes |
| --- | --- |
| ``INSTANTS`` | monotonic times, each with the age in ns from which on it makes no more difference; 0 and below are not times |
| ``PASSING`` | every step sets them before it reads them, they only count, or never change: neither saved nor compared |
| ``SERIALS`` | numbers that only grow, are only compared with each other, and are 0 for none: compared by their order |
| ``COUNTERS`` | numbers that run round, 0 for none: compared as they are, or by whether they are 0 (``any_counter``) |
| ``BITS`` | words of which only these bits are compared |
| ``SUPERVISION`` | compared only with ``stops``: only the brakes beside the Controlword depend on them |
| ``WHILE`` | without ``stops``, the object is compared only while this attribute has one of these values |
| ``DATA`` | compared only with ``data``: they are sent, and nothing else depends on them |
| ``ASIDE`` | saved, but not compared: no word and no command depends on them (caches, what the log has had); ``*``: all |
"""

from __future__ import annotations

from typing import Any, Final

from pdgw.base.durations import MS, SECOND
from pdgw.dsp402.drive.images import DriveCommand
from pdgw.dsp402.modes import MODE_CONFIRM_NS
from pdgw.gateway.axis.adapters.adapter import _UNCONTROLLED, Adapter, ControlWordAdapter
from pdgw.gateway.axis.adapters.position_words import PositionerAdapter
from pdgw.gateway.axis.adapters.transparent import TransparentAdapter
from pdgw.gateway.axis.answer import Answer
from pdgw.gateway.axis.demand_report import Demand, MotionDemand, PowerWish, SpeedDemand
from pdgw.gateway.axis.executors.dsc import DscExecutor
from pdgw.gateway.axis.executors.executor import LimitWatch
from pdgw.gateway.axis.executors.positions.handshake import ACKNOWLEDGE_NS, Handshake
from pdgw.gateway.axis.executors.positions.homing import Homing
from pdgw.gateway.axis.executors.positions.mode import ModeSwitch
from pdgw.gateway.axis.executors.positions.motion import MotionExecutor
from pdgw.gateway.axis.executors.positions.tasks import PositionerExecutor
from pdgw.gateway.axis.executors.raw import RawExecutor
from pdgw.gateway.axis.executors.speed import SpeedExecutor
from pdgw.gateway.axis.interlock import Commanded, Interlock, Remote
from pdgw.gateway.axis.machine import AxisMachine
from pdgw.gateway.axis.settings import ControlLost
from pdgw.gateway.axis.supervision.drive_events import Acknowledgement, DriveWatch, NodeWatch, Repetitions
from pdgw.gateway.axis.supervision.growth import Growth
from pdgw.gateway.axis.supervision.polled_speed import PolledSpeed
from pdgw.gateway.axis.supervision.position_speed import SAMPLE_NS, PositionSpeed
from pdgw.gateway.axis.supervision.stop_supervision import _OVER_NS, QUICK_STOPS, StopWatch
from pdgw.gateway.axis.supervision.torque_evidence import TorqueEvidence
from pdgw.gateway.axis.supervision.velocity_check import _COMPARE_NS, _OVERSPEED_NS, VelocityCheck
from pdgw.gateway.axis.values import Inputs, Outputs
from pdgw.gateway.motion.basic_positioner import BasicPositioner
from pdgw.gateway.motion.chain import BlockChain
from pdgw.gateway.motion.function_orders import EdgeOrder, JogOrder, Order, Stage
from pdgw.gateway.motion.modulo import Ring
from pdgw.gateway.motion.positioner import RISING, Positioner
from pdgw.gateway.motion.requests import Motion, PositionerFeedback
from pdgw.gateway.motion.travel import LIMIT_LEFT_NS, Course, Stall
from pdgw.gateway.motion.user_course import FIXED_STOP_NS, UserCourse
from pdgw.profidrive.sign_of_life import SignOfLife

OF: Final[dict[type, dict[str, Any]]] = {
    DriveCommand: {
        "ASIDE": frozenset({"controlword"}),
        "DATA": frozenset({"profile_acceleration", "profile_deceleration", "profile_velocity", "target_position"}),
    },
    ControlWordAdapter: {"PASSING": frozenset({"_uncontrolled"}), "ASIDE": frozenset({"unheard", "word"})},
    PositionerAdapter: {"ASIDE": frozenset({"_last"})},
    Answer: {"INSTANTS": lambda item: {"_since": item._latency}},
    Demand: {"ASIDE": frozenset({"*"})},
    # What it does at the end of a limit is done already.
    LimitWatch: {"INSTANTS": {"_since": LIMIT_LEFT_NS}, "ASIDE": frozenset({"shown"})},
    DscExecutor: {"INSTANTS": {"_last_frame_ns": SECOND}},
    Handshake: {"INSTANTS": {"raised_at": ACKNOWLEDGE_NS, "blocked_at": ACKNOWLEDGE_NS}},
    # No position of the walk is read by SDO.
    Homing: {"INSTANTS": lambda item: {"_started": item._latency}, "ASIDE": frozenset({"_attained_at"})},
    ModeSwitch: {"INSTANTS": {"since": MODE_CONFIRM_NS}, "PASSING": frozenset({"asked"})},
    MotionExecutor: {
        "PASSING": frozenset({"_positions"}),
        # No position of the walk is read by SDO; the last two are for the user alone.
        "ASIDE": frozenset({"_reaches_at", "_turned_at", "_homing_since", "_home_lost"}),
    },
    PositionerExecutor: {"SERIALS": frozenset({"_anchored"})},
    # No position of the walk is half of the numbers away from the one before: the count is the position.
    Ring: {"ASIDE": frozenset({"_raw", "_known"})},
    Stall: {"INSTANTS": lambda item: {"_since": item.time}},
    RawExecutor: {"ASIDE": frozenset({"_last"})},
    SpeedExecutor: {"ASIDE": frozenset({"_wire", "_value", "_limited"})},
    Interlock: {
        "ASIDE": frozenset({"_steady", "cell", "controlword", "reason"}),
    },
    Commanded: {
        "INSTANTS": lambda item: {
            "late_until": 0,
            "since": max(limit for row in item.limits.values() for limit in row.values()),
        },
    },
    # No drive of the walk is in local mode.
    Remote: {"ASIDE": frozenset({"known", "state", "since"})},
    Repetitions: {"ASIDE": frozenset({"_reported", "_repeated"})},
    NodeWatch: {
        "ASIDE": frozenset(
            {
                "fault_of_emcy",
                "fault_of_number",
                "last_fault",
                "proven",
                "unproven",
                "warnings",
                "_refusal",
                "_absent",
                "restart_asked",
            }
        )
    },
    Acknowledgement: {"ASIDE": frozenset({"_until", "_seen"})},
    DriveWatch: {
        "ASIDE": frozenset({"_supplied", "_is_older", "fault_began", "fault_since"}),
        "SUPERVISION": frozenset({"shown"}),
    },
    AxisMachine: {
        "PASSING": frozenset({"in_fault"}),
        "SUPERVISION": frozenset({"_late"}),
        "ASIDE": frozenset({"lags_since"}),
    },
    StopWatch: {
        "WHILE": ("order", QUICK_STOPS),
        # The time between two steps.
        "ASIDE": frozenset({"_at"}),
        "INSTANTS": lambda item: {
            "began": item._stopped_within + 1,
            "_line_at": item._stopped_within + 1,
            "_fell": item._stop_time + 1,
            "_slow": _OVER_NS + 1,
            "_ignored_since": max(item._enter, item._stopped_within, item._reaction) + 1,
            "_braked": item._reaction,
            "_still_since": 1,
        },
    },
    PolledSpeed: {
        "ASIDE": frozenset({"_word", "_asked"}),
        "INSTANTS": lambda item: {
            # The request to an answer of the next step is less than one step older.
            "_ordered_at": 200 * MS,
            "_ramp_at": item._reaction + item._stopped_within + 1,
            "_from_at": item._reaction + item._stopped_within + 1,
        },
    },
    # A note is made of these, and no command.
    VelocityCheck: {
        "ASIDE": frozenset({"apart", "_apart", "_apart_at"}),
        "INSTANTS": {
            "_at": SAMPLE_NS,
            "_compared_at": _COMPARE_NS,
            "_over_since": _OVERSPEED_NS,
        },
    },
    # No speed of the walk grows in five steps.
    Growth: {"ASIDE": frozenset({"*"})},
    TorqueEvidence: {"INSTANTS": {"_excused_at": SECOND}},
    PositionSpeed: {"INSTANTS": {"position_ns": SAMPLE_NS}},
    Inputs: {
        "ASIDE": frozenset({"now"}),
        "INSTANTS": {"speed_asked_ns": 300 * MS, "speed_until_ns": 1},
        "PASSING": frozenset(
            {
                "fault_code",
                "fresh",
                "drive_ok",
                "encoders",
                "encoders_ok",
                "gateway_stops",
                "node_stopped",
                "position_old",
                "set_point_refused",
                "setpoints",
                "standstill",
                "standstill_unknown",
                "unacknowledged",
            }
        ),
    },
    Outputs: {
        "PASSING": frozenset(
            {
                "good",
                "reason",
                "released",
                "saturations",
                "warning",
                "events",
                "found",
            }
        ),
        "ASIDE": frozenset({"actuals", "brake"}),
        "SUPERVISION": frozenset({"known_off"}),
    },
    BlockChain: {"INSTANTS": {"_wait_until": 0}},
    Positioner: {
        "PASSING": frozenset({"request", "seen"}),
        "BITS": {"_commands": RISING},
    },
    # Only a reason is made of the other stages, and of what an order lacked.
    Order: {"ASIDE": frozenset({"lack"})},
    EdgeOrder: {"BITS": {"stage": Stage.WAITS}},
    JogOrder: {"BITS": {"stage": Stage.READY | Stage.RUNS}},
    BasicPositioner: {"INSTANTS": {"_homing_until": 0}, "PASSING": frozenset({"_now"})},
    PositionerFeedback: {"SERIALS": frozenset({"given", "taken", "executing"}), "PASSING": frozenset({"bits"})},
    Motion: {"SERIALS": frozenset({"serial", "first"})},
    Course: {
        "PASSING": frozenset({"seen"}),
        "SERIALS": frozenset({"sent"}),
    },
    UserCourse: {"INSTANTS": {"_stop_since": FIXED_STOP_NS}, "SERIALS": frozenset({"queued"})},
    SignOfLife: {"COUNTERS": frozenset({"received", "due", "_own"})},
}
"""``INSTANTS`` may be a function of the object."""


def kept(adapter: Adapter, demand: Demand) -> tuple[object, ...]:
    """State that the next setpoints may leave unchanged: values, and objects compared completely."""
    if isinstance(adapter, TransparentAdapter):
        return ()
    if not isinstance(adapter, ControlWordAdapter):
        return (demand,)
    found: tuple[object, ...] = ()
    if demand.connected:
        found = (demand.acknowledge, isinstance(demand, SpeedDemand) and demand.device_bits)
    holds = adapter._uncontrolled is _UNCONTROLLED[ControlLost.HOLD]
    if demand.connected and holds and demand.power in {PowerWish.ENABLE, PowerWish.HOLD}:
        found = (demand,)
    if isinstance(adapter, PositionerAdapter) and isinstance(demand, MotionDemand):
        found = (*found, demand.motion.commands & adapter.KEPT)
    return found
