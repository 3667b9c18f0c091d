"""The safety rules of an axis: each is one function, with its sentence and its source.

The walk and the soak describe in ``Seen`` what they have seen of an axis, and report the broken rules. A rule has no clock: the
walk counts steps, the soak measures nanoseconds, and a field says what has lasted for longer than it may. A field without its
value breaks no rule. Nothing here comes from the power table or the interlock.
"""

from __future__ import annotations

import enum
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from pdgw.dsp402.states import ControlBit, State

ZSW1_OPERATION, ZSW1_FAULT, ZSW1_WARNING, ZSW1_REACHED, ZSW1_HOME_SET, ZSW1_ACKNOWLEDGED = (
    1 << bit for bit in (2, 3, 7, 10, 11, 12)
)
ENABLE: Final = 0xF
"""Bits 0 to 3 of Enable Operation, and of ON with STW1.3."""
UNPOWERED: Final = (
    State.NOT_READY_TO_SWITCH_ON,
    State.SWITCH_ON_DISABLED,
    State.READY_TO_SWITCH_ON,
    State.SWITCHED_ON,
)
FAULTY: Final = (State.FAULT, State.FAULT_REACTION_ACTIVE)
_STATES: Final = "PROFIdrive profile 4.1, state machine of the drive; docs/translation.md, States"
_OFFS: Final = "PROFIdrive profile 4.1, OFF1 to OFF3; docs/translation.md, Losses"
_WORDS: Final = "docs/translation.md, Standard telegrams"
_MOTION: Final = "docs/motion.md; docs/translation.md, Positioning"
_STOP: Final = "docs/safety.md, A drive that does not stop; CiA 301, node guarding and heartbeat"
_CALM: Final = "docs/verification.md, Calm days"


@dataclass(slots=True)
class Seen:
    """What was seen of an axis at one moment."""

    controlword: int = 0
    state: State | None = State.SWITCH_ON_DISABLED
    """State that the drive reports; None: it is lost, or reports no state."""
    zsw1: int = 0
    """0 while it may change."""
    reason: bool = False
    """The gateway reports why it does not follow."""
    age: int = 0
    """Time for which the shaft turns under power although no order moves it,"""
    bound: int = 0
    """and in which it must stop."""
    energizes: bool = False
    """Switch On or Enable Operation begins,"""
    on: bool = True
    """the PLC asks for it,"""
    released: bool = True
    """and has sent an OFF in this connection, after the last loss or fault."""
    held: bool = False
    """Enable Operation is kept without ON."""
    may_hold: bool = True
    """A ramp asks for it, and nothing forbids it."""
    ramps: bool = False
    """OFF1 or a loss with a ramp while the drive turns."""
    off2: bool = False
    off3: bool = False
    """OFF3, or a loss with a quick stop."""
    quick_stops: bool = False
    """The drive has not ended the quick stop of an order before."""
    may_coast: bool = True
    """The drive coasts already, or the PLC allows it."""
    moves: bool = False
    """A motion begins or continues."""
    ordered: bool = True
    """The PLC has ordered it in operation, and has not withdrawn the order."""
    operates: bool = True
    """The drive is in operation, by Enable Operation of the gateway."""
    follows: bool = True
    """The drive has reached the setpoint of the PLC, or turns with it."""
    accepted: bool = True
    """The drive has accepted the setpoint of the task."""
    homed: bool = True
    """The drive has homed since the order for it,"""
    homes: bool = False
    """and homes at this moment."""
    refused: bool = False
    """The gateway does not follow."""
    waits: bool = False
    """An order is not carried out in time."""
    guarded: bool = False
    """The final guard replaced an Enable Operation."""
    resets: bool = False
    """Fault Reset rises,"""
    acknowledges: bool = True
    """by an edge of the PLC in this connection."""
    brake: int = 0
    """Stop beside the Controlword: 1 by NMT, 2 by the missing heartbeat of the gateway,"""
    braked: int = 0
    """and the one before."""
    continues: bool = False
    """The drive does not do what the Controlword asks for,"""
    overdue: bool = False
    """for longer than its reaction time."""
    unstopped: bool = False
    """NMT Stop had no effect in time."""
    off: bool = True
    """The drive is seen without power, or its node has executed NMT Stop."""
    unstored: bool = False
    """An EMCY with an error is not reported in time."""
    stuck: bool = False
    """OFF, acknowledge and ON have not brought the axis into operation in time."""
    apart: bool = False
    """Shaft, setpoint and actual value of the speed still differ after their time."""
    reported: bool = False
    """The gateway reports a fault or a warning, or a device is lost, although all devices are healthy."""
    stopped: bool = False
    """A healthy drive with ON is not in operation."""
    denied: bool = False
    """The gateway reports a reason that the PLC did not cause."""

    @property
    def voltage(self) -> bool:
        """The Controlword is not Disable Voltage."""
        return self.controlword & ControlBit.ENABLE_VOLTAGE != 0

    @property
    def brakes(self) -> bool:
        """The Controlword is Quick Stop, or Disable Voltage for a drive that may coast."""
        return not self.controlword & ControlBit.QUICK_STOP if self.voltage else self.may_coast


class Rule(enum.Enum):
    """The rules: sentence, source, and the function that says whether the rule is broken."""

    def __init__(self, sentence: str, source: str, broken: Callable[[Seen], bool]) -> None:
        self.sentence = sentence
        self.source = source
        self.broken = broken

    def __reduce_ex__(self, _protocol: object) -> tuple[object, ...]:
        """By its name: the function cannot be sent to another process."""
        return getattr, (Rule, self.name)

    ON = (
        "the power stage is switched on only while the PLC asks for it",
        _STATES,
        lambda seen: seen.energizes and not seen.on,
    )
    RELEASED = (
        "no start without an OFF and then an ON in this connection, after the last loss or fault",
        _STATES,
        lambda seen: seen.energizes and not seen.released,
    )
    KEPT = (
        "Enable Operation is kept only in operation or for a ramp",
        _STATES,
        lambda seen: seen.held and not seen.may_hold,
    )
    RAMP = (
        "OFF1 and a loss with a ramp keep the power on until standstill",
        _OFFS,
        lambda seen: seen.ramps and seen.controlword & ENABLE != ENABLE,
    )
    OFF2 = (
        "OFF2 switches the voltage off in every state",
        _OFFS,
        lambda seen: seen.off2 and seen.voltage,
    )
    OFF3 = (
        "OFF3 and a loss with a quick stop brake the drive",
        _OFFS,
        lambda seen: seen.off3 and not seen.brakes and (seen.voltage or seen.state in {State.OPERATION_ENABLED, None}),
    )
    LATCH = (
        "a quick stop is not ended early",
        _OFFS,
        lambda seen: seen.quick_stops and not seen.brakes,
    )
    UNKNOWN = (
        "a lost drive, or one without a state, receives Quick Stop unless it coasts",
        "docs/translation.md, Losses",
        lambda seen: seen.state is None and not seen.brakes,
    )
    STOPS = (
        "a shaft that no order moves stops in time",
        _OFFS,
        lambda seen: seen.age > seen.bound,
    )
    MOVES = (
        "a motion starts in operation by an order of the PLC, and ends with the bit of homing or jog",
        _MOTION,
        lambda seen: seen.moves and not seen.ordered,
    )
    OPERATES = (
        "ZSW1.2 is 1 only in operation",
        _STATES,
        lambda seen: seen.zsw1 & ZSW1_OPERATION != 0 and not seen.operates,
    )
    FAULT = (
        "ZSW1.3 shows every fault of the drive",
        _STATES,
        lambda seen: seen.state is State.FAULT and not seen.zsw1 & ZSW1_FAULT,
    )
    REACHED = (
        "ZSW1.10 is 1 only while the drive follows the setpoint, or is at the target of its task",
        _WORDS,
        lambda seen: seen.zsw1 & ZSW1_REACHED != 0 and not seen.follows,
    )
    ACKNOWLEDGED = (
        "ZSW1.12 acknowledges only a task that the drive has accepted",
        _MOTION,
        lambda seen: seen.zsw1 & ZSW1_ACKNOWLEDGED != 0 and not seen.accepted,
    )
    HOMED = (
        "ZSW1.11 is 1 only after the drive has homed",
        _MOTION,
        lambda seen: seen.zsw1 & ZSW1_HOME_SET != 0 and not seen.homed,
    )
    HOMES = (
        "ZSW1.11 is 0 while the drive homes",
        _MOTION,
        lambda seen: seen.zsw1 & ZSW1_HOME_SET != 0 and seen.homes,
    )
    REASON = (
        "every refusal has a reason",
        _WORDS,
        lambda seen: seen.refused and not seen.reason,
    )
    WAITS = (
        "an order that is not carried out in time has a reason",
        _MOTION,
        lambda seen: seen.waits and not seen.reason,
    )
    GUARD = (
        "the final guard has nothing to stop",
        "docs/safety.md",
        lambda seen: seen.guarded,
    )
    RESET = (
        "Fault Reset is sent only by an edge of the PLC in this connection",
        _STATES,
        lambda seen: seen.resets and not seen.acknowledges,
    )
    LATE = (
        "a drive that does not stop within its reaction time is stopped by NMT",
        _STOP,
        lambda seen: seen.overdue and not seen.brake,
    )
    NEEDLESS = (
        "a drive that stops is not stopped by NMT",
        _STOP,
        lambda seen: seen.brake > 0 and not seen.braked and not seen.continues,
    )
    WITHHELD = (
        "a drive that NMT Stop does not stop loses the gateway's heartbeat",
        _STOP,
        lambda seen: seen.brake == 1 and seen.unstopped,
    )
    BRAKE = (
        "a brake is released only when the drive is seen without power, or when its node has executed NMT Stop",
        _STOP,
        lambda seen: seen.brake < seen.braked and not seen.off,
    )
    STORED = (
        "each EMCY with an error is in the fault buffer (P945, P948), or a warning",
        "docs/parameter-channel.md",
        lambda seen: seen.unstored,
    )
    RETURNS = (
        "OFF, acknowledge and ON bring every axis into operation, and OFF removes the power",
        _STATES,
        lambda seen: seen.stuck,
    )
    FOLLOWS = (
        "the shaft turns with the setpoint, and the PLC sees this speed",
        _WORDS,
        lambda seen: seen.apart,
    )
    CALM = (
        "the gateway reports no fault, no warning and no loss of a healthy device",
        _CALM,
        lambda seen: seen.reported,
    )
    RUNS = (
        "a healthy drive with ON stays in operation",
        _CALM,
        lambda seen: seen.stopped,
    )
    ALLOWED = (
        "the gateway gives no reason, except what the PLC asks for and, for a short time, a handshake with the drive",
        _CALM,
        lambda seen: seen.denied,
    )


_CHECKS: Final = tuple((rule, rule.broken) for rule in Rule)


def broken(seen: Seen) -> list[Rule]:
    """The rules that are broken."""
    return [rule for rule, is_broken in _CHECKS if is_broken(seen)]
