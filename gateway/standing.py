"""Where a drive object stands in the eyes of the user: a state word, and the chain of enables with the first link that is broken.

Both follow from the reason (``gateway.reasons`` declares what each one means) and from three facts: whether there is a PLC,
whether it asks for operation, whether power is on. Whoever shows them derives nothing from the bits of a word.
"""

from __future__ import annotations

from typing import NamedTuple

from pdgw.gateway.axis.waist import Demand, PowerWish
from pdgw.gateway.binding import Axis
from pdgw.gateway.encoder import EncoderObject
from pdgw.gateway.reasons import AxisState, Enable, Reason

AXIS_CHAIN = (
    Enable.PLC,
    Enable.CONTROL,
    Enable.NODE,
    Enable.NO_FAULT,
    Enable.ON_EDGE,
    Enable.OPERATION,
    Enable.SETPOINT,
)
ENCODER_CHAIN = (Enable.PLC, Enable.CONTROL, Enable.NODE, Enable.NO_FAULT, Enable.SENSOR)
_ASKS = (PowerWish.ON, PowerWish.ENABLE, PowerWish.RESUME, PowerWish.HOLD)


class ChainLink(NamedTuple):
    """One link of the chain. ``ok``: None behind a broken one, where nothing is known of it; ``todo``: of the broken one."""

    enable: Enable
    ok: bool | None
    todo: str = ""


class Break(NamedTuple):
    """A broken link and what to do about it."""

    enable: Enable
    todo: str


_SWITCHED_OFF = Break(Enable.ON_EDGE, "nothing is wrong: ON (STW1.0 = 1) switches the drive on")
"""An axis that is off because the PLC wants it so."""


class Standing(NamedTuple):
    """State word and chain."""

    state: AxisState
    chain: tuple[ChainLink, ...]


def asks_for_operation(demand: Demand) -> bool:
    """Whether the PLC is there and wants the axis in operation: what is missing then is the drive's to do."""
    return demand.connected and demand.power in _ASKS


def axis_standing(axis: Axis) -> Standing:
    """Of an axis, as its last step left it."""
    reason, demand = axis.reason, axis.machine.demand
    if reason is None:
        return Standing(AxisState.OBEYS, _chain(AXIS_CHAIN, None))
    state, broken = reason.state, Break(reason.enable, reason.remedy)
    if axis.powered and not axis.released and state is not AxisState.FAULT:
        state = AxisState.STOPPING
    elif state is AxisState.STARTING and not asks_for_operation(demand):
        state, broken = AxisState.OFF, _SWITCHED_OFF
    if axis.machine.inputs.setpoints is None:
        broken = _in_front(Reason.NO_PLC, broken, AXIS_CHAIN)
    return Standing(state, _chain(AXIS_CHAIN, broken))


def encoder_standing(encoder: EncoderObject) -> Standing:
    """Of an encoder, as its last step left it."""
    reason, machine = encoder.reason, encoder.machine
    if reason is None:
        return Standing(AxisState.OBEYS, _chain(ENCODER_CHAIN, None))
    broken = Break(reason.enable, reason.remedy)
    if machine.adapter.control is None:
        broken = _in_front(Reason.ENCODER_NO_PLC, broken, ENCODER_CHAIN)
    elif not machine.control.has_control:
        broken = _in_front(Reason.ENCODER_NO_CONTROL, broken, ENCODER_CHAIN)
    return Standing(reason.state, _chain(ENCODER_CHAIN, broken))


def _in_front(reason: Reason, broken: Break, enables: tuple[Enable, ...]) -> Break:
    """One reason is told at a time; what it tells may have something broken in front of it, which comes first then."""
    if enables.index(reason.enable) < enables.index(broken.enable):
        return Break(reason.enable, reason.remedy)
    return broken


def _chain(enables: tuple[Enable, ...], broken: Break | None) -> tuple[ChainLink, ...]:
    links: list[ChainLink] = []
    ok: bool | None = True
    for enable in enables:
        if broken is not None and enable is broken.enable:
            links.append(ChainLink(enable, False, broken.todo))
            ok = None
        else:
            links.append(ChainLink(enable, ok))
    return tuple(links)
