"""Commands to a sensor (Gn_STW bits 0-7) by name: reference mark search and measurement on the fly.

Source: docs/motion.md "Reference marks and measurement on the fly". A program runs like that of a positioner.
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
    """``read_value``: of a function with a stored value."""

    sensor: Literal[1, 2] = 1
    function: Annotated[int, Field(ge=_FUNCTIONS[0], le=_FUNCTIONS[-1])] = 1


class Measuring(Reading):
    """``measure``: one function. ``also`` has further ones, because a second step would abort the first."""

    also: tuple[Annotated[int, Field(ge=_FUNCTIONS[0], le=_FUNCTIONS[-1])], ...] = ()


class SensorWords:
    """The words of one sensor; GatewayError if the telegram has none."""

    def __init__(self, telegram: Telegram, sensor: int) -> None:
        self._control, self._status = f"G{sensor}_STW", f"G{sensor}_ZSW"
        if self._control not in telegram.setpoints.names:
            raise GatewayError(f"not possible with telegram {telegram.number}: it has no {self._control}")

    def _command(self, command: int, functions: Iterable[int], **bits: int) -> Program:
        """Send a command. It takes effect on a change, so the previous one is removed first."""
        chosen = {f"{self._control}.FUNCTION_{number}": int(number in functions) for number in _FUNCTIONS}
        more = {f"{self._control}.{name}": value for name, value in bits.items()}
        return [
            Ask({f"{self._control}.COMMAND": _NONE}),
            PULSE_NS,
            Ask({**chosen, **more, f"{self._control}.COMMAND": command}),
            PULSE_NS,
        ]

    def reference_mark(self) -> Program:
        """Search the zero pulse."""
        return self._command(_ACTIVATE, {1}, MODE=0)

    def measure(self, wish: Measuring) -> Program:
        """Measure positions at edges of the probes."""
        return self._command(_ACTIVATE, {wish.function, *wish.also}, MODE=1)

    def read_value(self, wish: Reading) -> Program:
        """Read a stored value; it stays in Gn_XIST2."""
        found = Wait({f"{self._status}.VALUE_{wish.function}": 1}, f"value of function {wish.function}")
        return [found, *self._command(_READ, {wish.function})]

    def stop(self) -> Program:
        """Abort all searches and measurements."""
        return [*self._command(_ABORT, _FUNCTIONS), Ask({f"{self._control}.COMMAND": _NONE})]
