"""The setpoint of an axis, and one that it does not follow: since when, and which limits of the drive are in force."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final

from pdgw.dsp402.modes import Mode
from pdgw.dsp402.objects import MODE_DISPLAY
from pdgw.dsp402.states import StatusBit
from pdgw.gateway.base.reasons import Finding, Reason
from pdgw.gateway.objects.axis import Axis
from pdgw.gateway.objects.inquiry import LIMITS, SENDS_NOTHING, LimitKind
from pdgw.profidrive.signal_text import value_text
from pdgw.profidrive.signals import Signal, SignalQuantity

_WIDEN: Final = ("raise this limit, or give a setpoint within it",)


def lag_of(axis: Axis) -> Finding | None:
    """An axis in operation that does not follow its setpoint; None if it follows, or if it has another reason."""
    lags = axis.machine.lags_since
    if not lags or axis.machine.outputs.reason is not None:
        return None
    found = Finding(Reason.LAGS, "does not follow its setpoint", Reason.LAGS.remedy, since_ns=lags)
    answer = axis.limits.answer
    if answer is not None and answer.silent:
        return found._replace(more=f": {SENDS_NOTHING.evidence}", remedy=SENDS_NOTHING.remedy)
    values = {} if answer is None else answer.values
    mode = values.get(MODE_DISPLAY, 0)
    present = [limit for limit in LIMITS if limit.address in values]
    explains = [limit for limit in present if _explains(axis, limit.kind, values[limit.address], mode)]
    shown = [f"{limit.address[0]:04X}h ({limit.name}) = {values[limit.address]}" for limit in explains or present]
    own = [*reductions(axis)]
    if axis.drive.feedback.statusword & StatusBit.INTERNAL_LIMIT:
        own.append("Statusword.11 = 1 (internal limit)")
    if explains or own:
        return found._replace(more=f": limited by {', '.join((*own, *(shown if explains else ())))}", remedy=_WIDEN)
    return found._replace(more=f"; limits of the drive: {', '.join(shown)}" if shown else "")


def setpoints(axis: Axis) -> Iterable[tuple[Signal, int]]:
    """The signals of the PLC with their raw values; empty without a PLC."""
    return zip(axis.telegram.setpoints.signals, axis.machine.inputs.setpoints or (), strict=False)


def speed_setpoint_rpm(axis: Axis) -> float | None:
    """The speed setpoint of the PLC; None without one, or while 100 % of the drive is unknown."""
    rated = axis.scaling.rated_speed_rpm
    for item, raw in setpoints(axis):
        percent = item.percent(raw) if item.quantity is SignalQuantity.SPEED else None
        if percent is not None and rated is not None:
            return percent * float(rated) / 100
    return None


def reductions(axis: Axis) -> Iterator[str]:
    """What the PLC itself reduces: MOMRED above 0."""
    for item, raw in setpoints(axis):
        if item.name == "MOMRED" and (item.percent(raw) or 0) > 0:
            yield f"MOMRED = {value_text(item, raw)}"


def _explains(axis: Axis, kind: LimitKind, value: int, mode: int) -> bool:
    """Whether a limit with this value keeps the axis from its setpoint in this mode of operation (6061h)."""
    if kind is LimitKind.TORQUE:
        return value == 0
    if kind is LimitKind.RAMP:
        return value == 0 and mode == Mode.VELOCITY
    if kind is LimitKind.SPEED:
        return value < abs(axis.outputs.command.target_velocity)
    setpoint = speed_setpoint_rpm(axis)
    return setpoint is not None and value < abs(setpoint)
