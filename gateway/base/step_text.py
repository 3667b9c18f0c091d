"""The one text of a remedy: status, page, log and documents have it from its steps."""

from __future__ import annotations

from typing import Final

from pdgw.gateway.base.steps import OFF_ON, Acknowledge, Bits, Edge, Give, Hindrance, Remedy, Step, Wait

_ACKNOWLEDGES: Final = {
    Hindrance.NONE: "then acknowledge ({bit})",
    Hindrance.PENDING: "the acknowledge ({bit}) is sent to the drive",
    Hindrance.NO_CONTROL: "{bit} has no effect while {control} = 0: set {control}, then acknowledge ({bit})",
    Hindrance.IN_VAIN: "it was acknowledged, but the cause is still there: remove it, then set {bit} to 0 and then to 1",
    Hindrance.LEVEL: "then acknowledge: it needs an edge, set {bit} to 0 and then to 1",
    Hindrance.UNHEARD: (
        "the edge of {bit} came with {control} or before it: keep {control} = 1, then set {bit} to 0 and then to 1"
    ),
    Hindrance.UNFINISHED: "set {bit} to 0: this ends the acknowledge",
}
_EXPLAINED: Final = "OFF and ON: the PLC's program must set STW1.0 to 0 and then to 1, with STW1.1 = STW1.2 = 1"


def equation(bits: tuple[str, ...], level: int) -> str:
    """``STW1.4 = STW1.5 = 1``."""
    return f"{' = '.join(bits)} = {level}"


def _first_text(step: Step) -> str:
    """The text of a step, as long as it is the first one."""
    match step:
        case Wait(until):
            return f"wait {until}".rstrip()
        case Bits(bits, 0) if len(bits) == 1:
            return f"set {bits[0]} to 0"
        case Bits(bits, level):
            return ("the PLC's program must " if level else "") + f"set {equation(bits, level)}"
        case Edge() if step == OFF_ON:
            return _EXPLAINED
        case Edge(bits, needs):
            rise = f"{bits[0]} to 0 and to 1" if len(bits) == 1 else f"{equation(bits, 0)}, then one of them to 1"
            return f"set {rise}{needs and f', with {equation(needs, 1)}' or ''}"
        case Acknowledge(bit, control, hindrance):
            return _ACKNOWLEDGES[hindrance].format(bit=bit, control=control)
        case Give(_, order):
            return order
    return step


def _next_text(step: Step) -> str:
    """The text of a step after another one, with what separates them."""
    if step == OFF_ON:
        return "; then OFF and ON"
    if isinstance(step, Edge):
        return f", and then a new edge of {' or '.join(step.bits)}"
    return f"; {_first_text(step)}"


def remedy_text(remedy: Remedy) -> str:
    """The text of all steps, in their order."""
    return "".join(_next_text(step) if place else _first_text(step) for place, step in enumerate(remedy))
