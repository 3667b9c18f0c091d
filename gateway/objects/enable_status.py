"""The state of a drive object as its chain of enables: what a link is, and the texts of the whole."""

from __future__ import annotations

from typing import NamedTuple

from pdgw.ds301.loop.loop import Loop
from pdgw.gateway.base.finding_text import evidence_text, finding_text
from pdgw.gateway.base.reasons import AxisState, Enable, Finding, Reason
from pdgw.gateway.base.step_text import remedy_text


class ChainLink(NamedTuple):
    """One link of the chain."""

    enable: Enable
    ok: bool | None
    """None if the link cannot be checked: a drive on a broken bus is unknown."""
    reason: Reason | None = None
    """Reason of a broken link."""
    found: Finding | None = None
    """Why the link is broken. This finding may have another reason: that of an earlier event which led to it."""
    loop: Loop | None = None
    """For the times of day."""

    @property
    def evidence(self) -> str:
        """The text that it is broken."""
        return "" if self.found is None else finding_text(self.found, self.loop)

    @property
    def todo(self) -> str:
        """The text of the remedy."""
        return "" if self.found is None else remedy_text(self.found.remedy)


class EnableStatus(NamedTuple):
    """State word and chain."""

    state: AxisState
    chain: tuple[ChainLink, ...]

    @property
    def broken(self) -> ChainLink | None:
        """The first broken link: it gives reason and remedy. None of an object in operation."""
        return next((link for link in self.chain if link.ok is False), None)

    @property
    def reason(self) -> Reason | None:
        """That of the first broken link."""
        return None if self.broken is None else self.broken.reason

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

    @property
    def untimed(self) -> EnableStatus:
        """The same with texts without times: an event has its own."""
        return self._replace(chain=tuple(link._replace(loop=None) for link in self.chain))

    @property
    def happening(self) -> str:
        """State and evidence alone."""
        link = self.broken
        return (
            self.state.value
            if link is None or link.found is None
            else f"{self.state.value}: {evidence_text(link.found)}"
        )
