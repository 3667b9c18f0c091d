"""A task of the basic positioner: the request of an edge of STW1.6, and whether it is possible."""

from __future__ import annotations

import enum
from dataclasses import dataclass

from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.motion.chain import BlockChain
from pdgw.gateway.motion.modulo import Direction
from pdgw.gateway.motion.requests import DIRECTIONS, Command, PositionerRequest
from pdgw.gateway.motion.states import Event
from pdgw.gateway.motion.user_course import UserCourse

_MDI_SELECTED, _ABSOLUTE, _SETTING_UP_SELECTED = Command.MDI, Command.ABSOLUTE, Command.SETTING_UP
_SETTING_UP_TASK, _BLOCK_TASK = Event.SETTING_UP, Event.BLOCK


@dataclass(slots=True, unsafe_hash=True)
class Task:
    """The request of the frame that brought an edge of STW1.6, or a change under continuous update. Never changed."""

    event: Event
    refusal: Reason | None
    request: PositionerRequest

    def is_of(self, request: PositionerRequest) -> bool:
        """Whether the request is unchanged."""
        own = self.request
        return (
            request.target == own.target
            and request.velocity == own.velocity
            and request.acceleration == own.acceleration
            and request.deceleration == own.deceleration
            and not (request.commands ^ own.commands) & DIRECTIONS
        )


class Acknowledge(enum.Enum):
    """Acknowledgement of a task, while STW1.6 is still 1 after its edge."""

    NONE = "none"
    OWED = "not shown yet"
    SHOWN = "shown"


def captured(request: PositionerRequest, chain: BlockChain, course: UserCourse) -> Task:
    """The task of this request, and why it is impossible."""
    commands = request.commands
    absolute, direction = commands & _ABSOLUTE != 0, request.direction
    refusal: Reason | None = None
    if not commands & _MDI_SELECTED:
        event = _BLOCK_TASK
        refusal = chain.refusal(request.number)
    else:
        event = _SETTING_UP_TASK if commands & _SETTING_UP_SELECTED else Event.MDI
        if not request.velocity:
            refusal = Reason.TASK_SPEED_ZERO
        elif request.acceleration <= 0 or request.deceleration <= 0:
            refusal = Reason.TASK_RAMP_ZERO
        elif event is _SETTING_UP_TASK:
            refusal = Reason.TASK_DIRECTION if direction is Direction.SHORTEST else None
        elif commands & DIRECTIONS == DIRECTIONS and course.choices.modulo and absolute:
            refusal = Reason.TASK_DIRECTION
        else:
            refusal = course.refusal(request.target, absolute, direction)
    return Task(event, refusal, request)
