"""The states of an application relationship, its events, and what it does then.

Source: IEC 61158-5-10/-6-10 (CMDEV, CMSM, CMPBE). The machine is ``TABLE``; tests walk every state and event.
"""

from __future__ import annotations

import enum
from typing import Final

from pdgw.profinet.rpc.records import PnioStatus

_RTA_ERROR, _RTA_PROTOCOL, _RTA_ERR_CLS = 0xCF, 0x81, 0xFD


class AbortCode(enum.IntEnum):
    """ErrorCode2 of an alarm ERR PDU: why a relationship ended."""

    SEQUENCE = 0x01
    DATA_HOLD = 0x05
    ACTIVITY_TIMEOUT = 0x06
    ALARM_UNACKNOWLEDGED = 0x08
    ALARM = 0x0B
    REQUESTED = 0x0D
    RE_RUN = 0x0E
    RELEASED = 0x0F
    PROTOCOL = 0x12
    CONTROL = 0x18
    LINK_DOWN = 0x1B
    NAME_CHANGED = 0x1F
    RESET = 0x20

    @property
    def status(self) -> PnioStatus:
        """As the PDU carries it."""
        return PnioStatus(_RTA_ERROR, _RTA_PROTOCOL, _RTA_ERR_CLS, self)


ABORT_TEXTS: Final = (
    "wrong sequence number",
    "instance closed",
    "out of memory",
    "no provider or consumer could be added",
    "data hold time expired",
    "activity timeout",
    "alarm relationship not opened",
    "alarm not acknowledged",
    "acknowledgement of an alarm not sent",
    "alarm data too long",
    "error of an alarm",
    "call of the device refused or not answered",
    "requested",
    "the controller connects again",
    "Release received",
    "device deactivated",
    "relationship removed",
    "protocol violation",
    "name not resolved",
    "RPC bind error",
    "Connect error",
    "Read error",
    "Write error",
    "Control error",
    "forbidden pull or plug before the first data",
    "application removed",
    "link down",
    "multicast address not registered",
    "not synchronised",
    "wrong topology",
    "station name changed",
    "reset to factory settings",
    "submodule of the first relationship prevents a companion",
    "no IRT data yet",
    "error of the interface or a port",
    "no port with the required speed or duplex mode",
    "IP suite of the controller changed",
    "redundancy data hold time expired",
    "interface or port cannot be parameterised",
    "no application ready in time",
    "redundant interface or access to the periphery impossible",
    "maximum takeover time expired",
    "protocol violation of a redundant relationship",
    "port plugged without its parameters",
    "network configuration missing or wrong",
)
"""ErrorCode2 of an alarm ERR PDU from 1 as text; ``AbortCode`` has those that the device sends.

Source: IEC 61158-6-10, as tshark has them.
"""


class State(enum.Enum):
    """States of a relationship."""

    PARAMETERISING = "connected, waits for PrmEnd"
    CONFIRMING = "ApplicationReady sent, waits for its confirmation"
    AWAITING_DATA = "confirmed, waits for the first data"
    DATA = "exchanges data"
    ACCESS = "device access without data"
    CLOSED = "ended"


class Event(enum.Enum):
    """Events of a relationship."""

    RECORD = "the controller reads or writes a record"
    PRM_END = "PrmEnd"
    PRM_BEGIN = "PrmBegin"
    CONFIRMED = "ApplicationReady is confirmed"
    DATA_RECEIVED = "a cyclic frame counts"
    RELEASE = "Release"
    PEER_ERROR = "the controller sent an alarm ERR"
    ACTIVITY_TIMEOUT = "the activity time is over"
    HOLD_EXPIRED = "the data hold time is over"
    UNCONFIRMED = "ApplicationReady is not confirmed after the last attempt, or refused"
    ALARM_UNACKNOWLEDGED = "an alarm is not acknowledged after the last repetition"
    RESTARTED = "the controller connects again"
    LINK_DOWN = "the cable is off"
    NAME_CHANGED = "name or address has changed"
    RESET = "reset to factory"
    STOPPED = "the device ends"


class Action(enum.Enum):
    """Actions of a relationship."""

    NOTHING = "nothing"
    RESTART_ACTIVITY = "start the activity time again"
    SEND_READY = "all statuses GOOD, ApplicationReady is sent"
    AWAIT_DATA = "start the activity time until the first data"
    CONNECT = "data counts from now on"
    HOLD_BACK = "all statuses BAD, start the activity time"
    REFUSE = "the service is refused: wrong state"
    ABORT = "send an alarm ERR, end"
    CLOSE = "end"


ABORTS: Final = {
    Event.ACTIVITY_TIMEOUT: AbortCode.ACTIVITY_TIMEOUT,
    Event.HOLD_EXPIRED: AbortCode.DATA_HOLD,
    Event.UNCONFIRMED: AbortCode.CONTROL,
    Event.ALARM_UNACKNOWLEDGED: AbortCode.ALARM_UNACKNOWLEDGED,
    Event.RESTARTED: AbortCode.RE_RUN,
    Event.LINK_DOWN: AbortCode.LINK_DOWN,
    Event.NAME_CHANGED: AbortCode.NAME_CHANGED,
    Event.RESET: AbortCode.RESET,
    Event.STOPPED: AbortCode.REQUESTED,
    Event.RELEASE: AbortCode.RELEASED,
}
"""Why the relationship ends by an event of this side or a Release; what an ERR PDU says where one is sent."""

_ENDS: Final = {
    **dict.fromkeys(ABORTS, (State.CLOSED, Action.ABORT)),
    # The controller ends it itself and needs no error.
    Event.RELEASE: (State.CLOSED, Action.CLOSE),
    Event.PEER_ERROR: (State.CLOSED, Action.CLOSE),
}
_P, _C, _A, _D, _X = State.PARAMETERISING, State.CONFIRMING, State.AWAITING_DATA, State.DATA, State.ACCESS
_SERVICES = (Event.PRM_END, Event.PRM_BEGIN)
TABLE: Final[dict[tuple[State, Event], tuple[State, Action]]] = {
    # A state ignores every event and rejects every service that is not listed for it below.
    **{(state, event): (state, Action.NOTHING) for state in State for event in Event},
    **{(state, event): (state, Action.REFUSE) for state in State for event in _SERVICES},
    **{(state, event): end for state in (_P, _C, _A, _D, _X) for event, end in _ENDS.items()},
    (_P, Event.RECORD): (_P, Action.RESTART_ACTIVITY),
    (_P, Event.PRM_END): (_C, Action.SEND_READY),
    (_C, Event.CONFIRMED): (_A, Action.AWAIT_DATA),
    (_C, Event.ACTIVITY_TIMEOUT): (_C, Action.NOTHING),
    (_A, Event.DATA_RECEIVED): (_D, Action.CONNECT),
    (_D, Event.PRM_BEGIN): (_P, Action.HOLD_BACK),
    (_D, Event.ACTIVITY_TIMEOUT): (_D, Action.NOTHING),
    (_X, Event.RECORD): (_X, Action.RESTART_ACTIVITY),
    (_X, Event.ACTIVITY_TIMEOUT): (State.CLOSED, Action.CLOSE),
}
