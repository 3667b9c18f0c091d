"""The power table: what the gateway does with the power stage of a drive, for every telegram.

Data, which ``power_cells`` compiles and ``interlock`` runs.

(phase, drive state, request) -> (phase, action). The first matching row counts. The documents print the rows, tests walk them.
Rules: an uncertain state is a stop, and after it nothing starts without an OFF and then an ON.
Source: docs/translation.md "States", "Standard telegrams" 3-4, docs/safety.md; the manufacturer's guide 5.1.
OFF1 of PROFIdrive ramps down before power is removed, Shutdown of CiA 402 does not: this table has the ramp stop. A telegram with
its own Controlword (100) has the phase PASS for operation and shares everything else.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from pdgw.gateway.axis.demand_report import OFF1S, OFFS, PowerWish
from pdgw.gateway.axis.orders import Order
from pdgw.gateway.axis.power_states import Action, Drive, Phase
from pdgw.gateway.base.fault_numbers import INTERNAL_FAULT, FaultNumber
from pdgw.gateway.base.reasons import Reason


@dataclass(frozen=True, slots=True)
class Row:
    """One row; ``phase`` None keeps the present phase; the user sees ``reason``. ``fault``: number of a stop without an order."""

    phases: tuple[Phase, ...]
    drives: tuple[Drive, ...]
    wishes: tuple[PowerWish, ...]
    phase: Phase | None
    action: Action
    reason: Reason | None
    why: str
    fault: int | None = None


P, D, W, A, F = Phase, Drive, PowerWish, Action, FaultNumber
ANY_PHASE: Final = tuple(Phase)
ANY_DRIVE: Final = tuple(Drive)
ANY_WISH: Final = tuple(PowerWish)
ENABLES: Final = (W.ENABLE, W.RESUME)
NO_PLC: Final = (W.NO_PLC_RAMP, W.NO_PLC_QUICK_STOP, W.NO_PLC_COAST)
RAMPS: Final = (W.NO_PLC_RAMP, W.STOP)
ON_WISHES: Final = (W.ON, *ENABLES, W.HOLD)
UNASKED: Final = (*NO_PLC, W.STOP)
"""Only a stop is requested."""
COASTS: Final = (W.COAST, W.NO_PLC_COAST)
DISABLES: Final = (W.ON, W.OFF_DISABLED, W.QUICK_STOP_DISABLED)
"""Disable Operation (STW1.3 = 0): ends a ramp or quick stop, as the profile's state S5 does."""
OFF3S: Final = (W.QUICK_STOP, W.QUICK_STOP_DISABLED)
QUICK_STOP_WISHES: Final = (*OFF3S, W.NO_PLC_QUICK_STOP)
IN_OPERATION: Final = (D.OPERATING, D.STANDING)
"""Operation enabled as commanded."""
SHOWS_OPERATION: Final = (*IN_OPERATION, D.LEAVING)
"""The Statusword shows Operation Enabled."""
QUICK_STOPS: Final = (D.QUICK_STOPPING, D.QUICK_STOPPED)
OFF: Final = (D.NOT_READY, D.DISABLED, D.FELL_OFF, D.INHIBITED)
"""Without power, and no Controlword on its way can change that."""
UNPOWERED: Final = (*OFF, D.READY, D.SWITCHED_ON, D.ENTERING, D.LOCAL, D.FELL_BACK)
UNREAD: Final = (D.POWERED_UNREAD, D.NO_REFERENCES, D.RESTARTED)
RUNNING: Final = (P.FOLLOW, P.PASS)
LOCKS: Final = (P.LOCKED, P.INHIBITED)
"""Power is off, and only an OFF is accepted."""
STOPPING: Final = (P.RAMP_STOP, P.SHUTDOWN, P.QUICK_STOP)
RAMPING: Final = (P.RAMP_STOP, P.SHUTDOWN)

ROWS: Final = (
    Row(
        ANY_PHASE,
        (D.FAULT,),
        ANY_WISH,
        P.LOCKED,
        A.DISABLE_VOLTAGE,
        Reason.DRIVE_FAULT,
        "the drive stops by itself",
        INTERNAL_FAULT,
    ),
    # OFF2 has the highest priority, and stays until the drive reports power off.
    Row(ANY_PHASE, (D.LOST,), COASTS, P.COAST, A.DISABLE_VOLTAGE, Reason.DRIVE_OFFLINE, "OFF2 of a lost drive"),
    Row(ANY_PHASE, (D.UNKNOWN,), COASTS, P.COAST, A.DISABLE_VOLTAGE, Reason.DRIVE_UNKNOWN_STATE, "OFF2 in any case"),
    Row(ANY_PHASE, UNREAD, COASTS, P.COAST, A.DISABLE_VOLTAGE, Reason.REFERENCE_INVALID, "OFF2 in any case"),
    Row(ANY_PHASE, OFF, COASTS, P.LOCKED, A.DISABLE_VOLTAGE, Reason.COAST_STOP, "OFF2 of a drive that is off"),
    Row(ANY_PHASE, ANY_DRIVE, COASTS, P.COAST, A.DISABLE_VOLTAGE, Reason.COAST_STOP, "OFF2"),
    Row((P.COAST,), (D.LOST,), ANY_WISH, None, A.DISABLE_VOLTAGE, Reason.DRIVE_OFFLINE, "OFF2 stays", F.NODE_LOST),
    Row(
        (P.COAST,),
        (D.UNKNOWN,),
        ANY_WISH,
        None,
        A.DISABLE_VOLTAGE,
        Reason.DRIVE_UNKNOWN_STATE,
        "OFF2 stays",
        F.STATE_UNKNOWN,
    ),
    Row((P.COAST,), UNREAD, ANY_WISH, None, A.DISABLE_VOLTAGE, Reason.REFERENCE_INVALID, "OFF2 stays", F.REFERENCE),
    Row(
        (P.COAST,),
        (*SHOWS_OPERATION, *QUICK_STOPS),
        ANY_WISH,
        None,
        A.DISABLE_VOLTAGE,
        Reason.NEEDS_OFF,
        "OFF2 stays until the drive is off",
    ),
    # State unknown, in every other phase.
    Row(
        ANY_PHASE,
        (D.POWERED_UNREAD, D.RESTARTED),
        ANY_WISH,
        P.UNCONFIRMED,
        A.QUICK_STOP,
        Reason.REFERENCE_INVALID,
        "the drive may be turning",
        F.REFERENCE,
    ),
    Row(
        (P.UNCONFIRMED,),
        (D.NO_REFERENCES,),
        ANY_WISH,
        None,
        A.QUICK_STOP,
        Reason.REFERENCE_INVALID,
        "its state is still unknown",
        F.REFERENCE,
    ),
    Row(
        ANY_PHASE, (D.NO_REFERENCES,), ANY_WISH, P.LOCKED, A.DISABLE_VOLTAGE, Reason.REFERENCE_INVALID, "", F.REFERENCE
    ),
    Row(
        ANY_PHASE,
        (D.LOST,),
        ANY_WISH,
        P.UNCONFIRMED,
        A.QUICK_STOP,
        Reason.DRIVE_OFFLINE,
        "the drive may be turning",
        F.NODE_LOST,
    ),
    Row(
        ANY_PHASE,
        (D.UNKNOWN,),
        ANY_WISH,
        P.UNCONFIRMED,
        A.QUICK_STOP,
        Reason.DRIVE_UNKNOWN_STATE,
        "the drive may be turning",
        F.STATE_UNKNOWN,
    ),
    # In any state, a drive without power accepts only an OFF.
    Row(
        (*LOCKS, P.UNCONFIRMED, P.COAST, *STOPPING),
        UNPOWERED,
        OFF1S,
        P.FOLLOW,
        A.SHUTDOWN,
        Reason.NOT_OPERATING,
        "a start begins with OFF",
    ),
    Row(
        (*LOCKS, P.UNCONFIRMED, P.COAST, *STOPPING),
        UNPOWERED,
        (W.RAW_OFF,),
        P.PASS,
        A.PASS,
        Reason.NOT_OPERATING,
        "a start begins with OFF (telegram 100)",
    ),
    Row(
        (P.UNCONFIRMED,),
        (D.DISABLED, D.FELL_OFF),
        ANY_WISH,
        P.LOCKED,
        A.DISABLE_VOLTAGE,
        Reason.NEEDS_OFF,
        "the drive is off",
    ),
    Row((P.UNCONFIRMED,), UNPOWERED, ANY_WISH, None, A.QUICK_STOP, Reason.NEEDS_OFF, "the Statusword may be wrong"),
    Row(
        (*LOCKS, P.COAST, *STOPPING),
        UNPOWERED,
        OFF3S,
        P.LOCKED,
        A.QUICK_STOP,
        Reason.QUICK_STOP,
        "OFF3",
    ),
    Row(
        (P.INHIBITED,),
        OFF,
        ON_WISHES,
        None,
        A.SHUTDOWN,
        Reason.INHIBITED,
        "Shutdown shows when STO or the supply is back",
    ),
    Row(
        (*LOCKS, P.COAST, *STOPPING),
        UNPOWERED,
        ANY_WISH,
        P.LOCKED,
        A.DISABLE_VOLTAGE,
        Reason.NEEDS_OFF,
        "the drive is off",
    ),
    # The drive operates without a command of this PLC.
    Row(
        (*LOCKS, P.UNCONFIRMED),
        QUICK_STOPS,
        ANY_WISH,
        P.QUICK_STOP,
        A.QUICK_STOP,
        Reason.QUICK_STOP,
        "a quick stop is completed",
        F.LEFT_OPERATION,
    ),
    Row(
        (P.UNCONFIRMED,),
        SHOWS_OPERATION,
        ANY_WISH,
        None,
        A.QUICK_STOP,
        Reason.NEEDS_OFF,
        "in operation without a command",
        F.LEFT_OPERATION,
    ),
    Row(
        LOCKS,
        SHOWS_OPERATION,
        (W.NO_PLC_RAMP, *QUICK_STOP_WISHES),
        P.QUICK_STOP,
        A.QUICK_STOP,
        Reason.QUICK_STOP,
        "in operation without a command",
        F.LEFT_OPERATION,
    ),
    Row(
        LOCKS,
        SHOWS_OPERATION,
        ANY_WISH,
        P.LOCKED,
        A.DISABLE_VOLTAGE,
        Reason.NEEDS_OFF,
        "power off was commanded",
        F.LEFT_OPERATION,
    ),
    # The loss of the PLC, or of its control, in operation.
    Row(RUNNING, (D.OPERATING,), RAMPS, P.RAMP_STOP, A.RAMP, Reason.RAMP_STOP, "as OFF1"),
    Row(RUNNING, (D.STANDING,), RAMPS, P.SHUTDOWN, A.RAMP_END, Reason.RAMP_STOP, "as OFF1 at standstill"),
    Row(
        RUNNING,
        (D.LEAVING,),
        (*RAMPS, W.HOLD),
        P.SHUTDOWN,
        A.RAMP_END,
        Reason.RAMP_STOP,
        "a ramp would enable the drive again",
    ),
    Row(
        RUNNING,
        (D.ENTERING, D.LOCAL),
        (*RAMPS, W.HOLD, *QUICK_STOP_WISHES),
        P.UNCONFIRMED,
        A.QUICK_STOP,
        Reason.QUICK_STOP,
        "the drive may be in operation already",
    ),
    Row(
        (*RUNNING, *RAMPING),
        SHOWS_OPERATION,
        (W.NO_PLC_QUICK_STOP,),
        P.QUICK_STOP,
        A.QUICK_STOP,
        Reason.PLC_LOST,
        "as OFF3",
    ),
    Row(RUNNING, QUICK_STOPS, UNASKED, P.QUICK_STOP, A.QUICK_STOP, Reason.QUICK_STOP, "the drive is stopping already"),
    Row(RUNNING, UNPOWERED, (*UNASKED, W.HOLD), P.LOCKED, A.DISABLE_VOLTAGE, Reason.NEEDS_OFF, "the drive is off"),
    # The drive disabled itself: an ON that is still active does not restart it.
    Row(
        (P.FOLLOW,), (D.FELL_BACK, D.FELL_OFF), OFFS, None, A.SHUTDOWN, Reason.NOT_OPERATING, "the PLC sends OFF anyway"
    ),
    Row((P.PASS,), (D.FELL_BACK, D.FELL_OFF), OFFS, None, A.PASS, Reason.NOT_OPERATING, "the PLC sends OFF anyway"),
    Row(
        RUNNING,
        (D.FELL_OFF,),
        ANY_WISH,
        P.LOCKED,
        A.DISABLE_VOLTAGE,
        Reason.NEEDS_OFF,
        "enable input, coast",
        F.LEFT_OPERATION,
    ),
    Row(
        RUNNING,
        (D.FELL_BACK,),
        ANY_WISH,
        P.UNCONFIRMED,
        A.QUICK_STOP,
        Reason.NEEDS_OFF,
        "the Statusword may be wrong",
        F.LEFT_OPERATION,
    ),
    # OFF3 locks, whether the drive has received it or not.
    Row(RUNNING, SHOWS_OPERATION, OFF3S, P.QUICK_STOP, A.QUICK_STOP, Reason.QUICK_STOP, "OFF3"),
    Row(RUNNING, UNPOWERED, OFF3S, P.LOCKED, A.QUICK_STOP, Reason.QUICK_STOP, "OFF3"),
    Row(
        RUNNING,
        QUICK_STOPS,
        ANY_WISH,
        P.QUICK_STOP,
        A.QUICK_STOP,
        Reason.QUICK_STOP,
        "quick stop by the drive itself",
        F.LEFT_OPERATION,
    ),
    # The Controlword of telegram 100.
    Row((P.PASS,), SHOWS_OPERATION, ANY_WISH, None, A.PASS, None, "the PLC's own Controlword"),
    Row((P.PASS,), ANY_DRIVE, ANY_WISH, None, A.PASS, Reason.NOT_OPERATING, "the PLC's own Controlword"),
    # In operation.
    Row((P.FOLLOW,), IN_OPERATION, (*ENABLES, W.HOLD), None, A.ENABLE_OPERATION, None, "operation"),
    Row((P.FOLLOW,), (D.LEAVING,), ENABLES, None, A.SWITCH_ON, Reason.NOT_OPERATING, "wait for Switched On first"),
    Row((P.FOLLOW,), IN_OPERATION, OFFS, P.RAMP_STOP, A.RAMP, Reason.RAMP_STOP, "OFF1"),
    Row((P.FOLLOW,), (D.LEAVING,), OFFS, None, A.SHUTDOWN, Reason.NOT_OPERATING, "a ramp would enable the drive again"),
    Row((P.FOLLOW,), SHOWS_OPERATION, (W.ON,), None, A.SWITCH_ON, Reason.NOT_OPERATING, "Disable Operation"),
    # Between off and operation, in both directions.
    Row((P.FOLLOW,), UNPOWERED, OFFS, None, A.SHUTDOWN, Reason.NOT_OPERATING, "OFF1"),
    Row(
        (P.FOLLOW,),
        (D.INHIBITED,),
        ANY_WISH,
        P.INHIBITED,
        A.SHUTDOWN,
        Reason.INHIBITED,
        "the end of STO, or a late supply, starts nothing",
    ),
    Row(
        (P.FOLLOW,),
        (D.LOCAL,),
        ENABLES,
        P.UNCONFIRMED,
        A.QUICK_STOP,
        Reason.LOCAL_MODE,
        "the end of local mode starts nothing",
    ),
    Row((P.FOLLOW,), (D.NOT_READY, D.DISABLED), ANY_WISH, None, A.SHUTDOWN, Reason.NOT_OPERATING, "transition 2 first"),
    Row(
        (P.FOLLOW,),
        (D.SWITCHED_ON, D.ENTERING),
        ENABLES,
        None,
        A.ENABLE_OPERATION,
        Reason.NOT_OPERATING,
        "transition 4",
    ),
    Row((P.FOLLOW,), UNPOWERED, ANY_WISH, None, A.SWITCH_ON, Reason.NOT_OPERATING, "transition 3"),
    # The ramp stop.
    Row(
        RAMPING,
        (*SHOWS_OPERATION, *QUICK_STOPS),
        OFF3S,
        P.QUICK_STOP,
        A.QUICK_STOP,
        Reason.QUICK_STOP,
        "OFF3 takes over",
    ),
    Row((P.RAMP_STOP,), IN_OPERATION, (W.RESUME,), P.FOLLOW, A.ENABLE_OPERATION, None, "only with `ramp_stop_resume`"),
    Row(
        RAMPING, SHOWS_OPERATION, DISABLES, P.SHUTDOWN, A.RAMP_END, Reason.RAMP_STOP, "Disable Operation ends the stop"
    ),
    Row((P.RAMP_STOP,), (D.OPERATING,), ANY_WISH, None, A.RAMP, Reason.RAMP_STOP, "ramp to standstill"),
    Row(RAMPING, SHOWS_OPERATION, ANY_WISH, P.SHUTDOWN, A.RAMP_END, Reason.RAMP_STOP, "at standstill"),
    # The quick stop.
    Row(
        STOPPING,
        (*SHOWS_OPERATION, *QUICK_STOPS),
        DISABLES,
        P.COAST,
        A.DISABLE_VOLTAGE,
        Reason.QUICK_STOP,
        "Disable Operation ends the stop",
    ),
    Row(
        STOPPING,
        (D.QUICK_STOPPED,),
        ANY_WISH,
        P.QUICK_STOP,
        A.DISABLE_VOLTAGE,
        Reason.QUICK_STOP,
        "the quick stop is complete",
    ),
    Row(STOPPING, ANY_DRIVE, ANY_WISH, P.QUICK_STOP, A.QUICK_STOP, Reason.QUICK_STOP, "the stop continues"),
)
"""The whole table."""


ORDER_ROWS: Final = (
    ((D.ENTERING,), (A.ENABLE_OPERATION,), ANY_WISH, Order.ENTER),
    ((*UNPOWERED, D.NO_REFERENCES), tuple(A), ANY_WISH, Order.NONE),
    (ANY_DRIVE, (A.PASS,), ANY_WISH, Order.NONE),
    (IN_OPERATION, (A.ENABLE_OPERATION,), ANY_WISH, Order.NONE),
    (SHOWS_OPERATION, (A.SWITCH_ON, A.SHUTDOWN), ANY_WISH, Order.DISABLE),
    (ANY_DRIVE, (A.RAMP,), ANY_WISH, Order.RAMP),
    (ANY_DRIVE, (A.QUICK_STOP,), ANY_WISH, Order.STOP),
    (ANY_DRIVE, (A.DISABLE_VOLTAGE,), COASTS, Order.OFF2),
    (ANY_DRIVE, tuple(A), ANY_WISH, Order.OFF),
)
"""(state, command, request) -> order; the first matching row counts, and each cell of the table above has one."""
