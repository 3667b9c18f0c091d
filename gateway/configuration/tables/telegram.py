"""The telegrams of a user's own: ``[[telegram]]``."""

from __future__ import annotations

from pydantic import model_validator

from pdgw.explain import misplaced
from pdgw.gateway.axis.telegrams import add_telegram
from pdgw.gateway.configuration.tables.environment import Integer, Section
from pdgw.gateway.errors import GatewayError
from pdgw.profidrive.errors import ProfidriveError


class TelegramConfig(Section):
    """A telegram by its signals. It is known to the process, to axes and commands alike, as soon as it is read."""

    number: Integer
    """P922, 999 to 32767."""
    like: Integer
    """The telegram that it is carried out as: a speed telegram or one of DSC."""
    setpoints: tuple[str, ...]
    actuals: tuple[str, ...]
    """Names of the signals in the order of the frame (docs/tables.md)."""

    @model_validator(mode="after")
    def _is_possible(self) -> TelegramConfig:
        try:
            add_telegram(self.number, self.like, self.setpoints, self.actuals)
        except (GatewayError, ProfidriveError) as error:
            raise misplaced(str(error)) from error
        return self
