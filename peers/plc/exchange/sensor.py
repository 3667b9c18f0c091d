"""What a PLC program asks of a sensor (Gn_STW bits 0-7), by name: reference mark search and measurement on the fly.

Source: docs/motion.md "Reference marks and measurement on the fly". A program is played as a positioner's.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Final, Literal

from pydantic import BaseModel, ConfigDict, Field

from pdgw.gateway.errors import GatewayError
from pdgw.peers.plc.exchange.positioner import PULSE_NS, Ask, Program, Wait
from pdgw.profidrive.telegrams import Telegram

_FUNCTIONS: Final = (1, 2, 3, 4)
_NONE, _ACTIVATE, _READ, _ABORT = range(4)
"""Gn_STW.COMMAND."""


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Reading(_Model):
    """``read_value``: of a function that has one."""

    sensor: Literal[1, 2] = 1
    function: Annotated[int, Field(ge=_FUNCTIONS[0], le=_FUNCTIONS[-1])] = 1


class Measuring(Reading):
    """``measure``: one function; a step for each where several are wanted would end the one before, so ``also`` has them."""

    also: tuple[Annotated[int, Field(ge=_FUNCTIONS[0], le=_FUNCTIONS[-1])], ...] = ()


class SensorWords:
    """The words of one sensor; GatewayError where the telegram has none."""

    def __init__(self, telegram: Telegram, sensor: int) -> None:
        self._control, self._status = f"G{sensor}_STW", f"G{sensor}_ZSW"
        if self._control not in telegram.setpoints.names:
            raise GatewayError(f"not possible with telegram {telegram.number}: it has no {self._control}")

    def _command(self, command: int, functions: Iterable[int], **bits: int) -> Program:
        """A command counts when it changes, so none stands before it."""
        chosen = {f"{self._control}.FUNCTION_{number}": int(number in functions) for number in _FUNCTIONS}
        more = {f"{self._control}.{name}": value for name, value in bits.items()}
        return [
            Ask({f"{self._control}.COMMAND": _NONE}),
            PULSE_NS,
            Ask({**chosen, **more, f"{self._control}.COMMAND": command}),
            PULSE_NS,
        ]

    def reference_mark(self) -> Program:
        """The zero pulse."""
        return self._command(_ACTIVATE, {1}, MODE=0)

    def measure(self, wish: Measuring) -> Program:
        """Positions at edges of the probes."""
        return self._command(_ACTIVATE, {wish.function, *wish.also}, MODE=1)

    def read_value(self, wish: Reading) -> Program:
        """A value that was found; it stays in Gn_XIST2."""
        found = Wait({f"{self._status}.VALUE_{wish.function}": 1}, f"value of function {wish.function}")
        return [found, *self._command(_READ, {wish.function})]

    def stop(self) -> Program:
        """Nothing is searched or measured any more."""
        return [*self._command(_ABORT, _FUNCTIONS), Ask({f"{self._control}.COMMAND": _NONE})]
