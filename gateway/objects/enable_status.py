"""The state of a drive object as its chain of enables: what a link is, and the texts of the whole."""

from __future__ import annotations

import re
from typing import NamedTuple

from pdgw.gateway.base.reasons import AxisState, Enable, Reason
from pdgw.gateway.base.step_text import remedy_text
from pdgw.gateway.base.steps import Remedy

_TIME = re.compile(r",? \(?(?:since|at) \d\d:")


class ChainLink(NamedTuple):
    """One link of the chain."""

    enable: Enable
    ok: bool | None
    """None if the link cannot be checked: a drive on a broken bus is unknown."""
    reason: Reason | None = None
    """Reason of a broken link."""
    evidence: str = ""
    """Evidence that it is broken."""
    remedy: Remedy = ()

    @property
    def todo(self) -> str:
        """The text of the remedy."""
        return remedy_text(self.remedy)


def untimed(text: str) -> str:
    """A text without its time and what follows."""
    return _TIME.split(text)[0]


class EnableStatus(NamedTuple):
    """State word and chain."""

    state: AxisState
    chain: tuple[ChainLink, ...]

    @property
    def broken(self) -> ChainLink | None:
        """The first broken link: it gives reason and remedy. None of an object in operation."""
        return next((link for link in self.chain if link.ok is False), None)

    @property
    def sentence(self) -> str:
        """State, reason and remedy: ``Fault: EMCY 7305h incremental sensor 1, since 14:02:11. Check the encoder cable.``"""
        link = self.broken
        return self.text if link is None else f"{self.text}. {link.todo[:1].upper()}{link.todo[1:]}."

    @property
    def text(self) -> str:
        """State and reason."""
        link = self.broken
        return self.state.value if link is None else f"{self.state.value}: {link.evidence}"
