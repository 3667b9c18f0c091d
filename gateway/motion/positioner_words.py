"""POS_ZSW1 and POS_ZSW2 of the basic positioner. Source: docs/motion.md."""

from __future__ import annotations

from typing import Final

from pdgw.gateway.motion.requests import MotionKind, Seen
from pdgw.gateway.motion.states import State
from pdgw.gateway.motion.user_course import UserCourse
from pdgw.profidrive.signals import signal

_STANDSTILL = Seen.STANDSTILL
_FIRST = {bit.name: bit.mask for bit in signal("POS_ZSW1").bits}
_SECOND = {bit.name: bit.mask for bit in signal("POS_ZSW2").bits}
FUNCTION_BITS = {
    State.BLOCK: _FIRST["BLOCK_MODE"],
    State.SETTING_UP: _FIRST["SETTING_UP"],
    State.MDI: _FIRST["MDI_ACTIVE"],
}
"""POS_ZSW1 bits of the displayed function,"""
RUNNING_BITS = dict.fromkeys((State.JOG, State.JOG_INCREMENTAL), _FIRST["JOGGING"])
"""and of the one that is."""
HOMING_SHOWN: Final = _FIRST["HOMING"]
PASSIVE_HOMING_SHOWN: Final = _FIRST["PASSIVE_HOMING"]
_STATIONARY: Final = _SECOND["SETPOINT_STATIONARY"]
_AT_SETPOINT: Final = _STATIONARY | _SECOND["SETPOINT_REACHED"]
_TRAVERSING: Final = _SECOND["TRAVERSING"]
_FORWARD: Final = _SECOND["MOVES_FORWARD"]
_BACKWARD: Final = _SECOND["MOVES_BACKWARD"]
OUTPUT_1: Final = signal("POS_ZSW2").bit("OUTPUT_1").position
_TRACKING = State.TRACKING


def limit_bits(seen: int) -> int:
    """POS_ZSW1 bits of the hardware limit switches."""
    bits = 0
    if seen & Seen.NEGATIVE_LIMIT:
        bits |= _FIRST["NEGATIVE_HARDWARE_LIMIT"]
    if seen & Seen.POSITIVE_LIMIT:
        bits |= _FIRST["POSITIVE_HARDWARE_LIMIT"]
    return bits


def second_word(course: UserCourse, state: State, speed: int, *, reached: bool) -> int:
    """POS_ZSW2 without the outputs of blocks. ``speed``: its sign is the direction."""
    seen = course.seen.bits
    second = _AT_SETPOINT
    if not reached:
        second = _STATIONARY if course.motion.kind is MotionKind.STAND else _TRAVERSING
    if not seen & _STANDSTILL:
        second |= _FORWARD if speed > 0 else _BACKWARD
    elif course.limits is not None:
        position, window = course.seen.position + course.offset, course.choices.position_window
        low, high = course.limits
        if position <= low + window:
            second |= _SECOND["SOFTWARE_LIMIT_MINUS"]
        if position >= high - window:
            second |= _SECOND["SOFTWARE_LIMIT_PLUS"]
    if state is _TRACKING:
        second |= _SECOND["TRACKING"]
    if course.speed_limited:
        second |= _SECOND["SPEED_LIMITED"]
    goal = course.goal
    if goal is not None and goal.torque is not None:
        second |= _SECOND["TO_FIXED_STOP"]
    if course.fixed_stop:
        second |= _SECOND["FIXED_STOP_REACHED"] | _SECOND["CLAMPING_TORQUE_REACHED"]
    return second
