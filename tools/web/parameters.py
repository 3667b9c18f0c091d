"""Declarations and parameters for the page.

What the page has to know to show words by name and by bit, taken from the declarations: nothing is said twice. The parameter
channel as the page of ``pdgw web`` reads it: blocking calls, one connection for each.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.reasons import AxisState
from pdgw.gateway.client.address import parse_target
from pdgw.gateway.client.dump import read_all
from pdgw.gateway.client.session import Element, Session, address_text, meaning
from pdgw.gateway.client.udp import ParameterClient
from pdgw.profidrive.signals import Signal
from pdgw.profidrive.telegrams import TELEGRAMS, ApplicationMode, Telegram, TelegramHalf
from pdgw.tools.web.support import RequestError

SYMBOLS = {
    AxisState.OBEYS: "●",
    AxisState.OFF: "○",
    AxisState.STARTING: "◌",
    AxisState.WAITS: "▲",
    AxisState.STOPPING: "▲",
    AxisState.FAULT: "■",
    AxisState.NOT_ON_THE_BUS: "■",
}
"""Shown before the word of a state: what colour says is also said without."""


def _signal(signal: Signal, *, positioning: bool) -> dict[str, Any]:
    return {
        "name": signal.name,
        "description": signal.description,
        "digits": 2 * signal.type.size,
        "bits": [
            {"position": bit.position, "width": bit.width, "name": bit.name, "meaning": bit.meaning}
            for bit in signal.fields(positioning=positioning)
        ],
    }


def _half(half: TelegramHalf) -> list[dict[str, Any]]:
    return [_signal(signal, positioning=half.mode is ApplicationMode.POSITIONING) for signal in half.signals]


@lru_cache(maxsize=len(TELEGRAMS))
def telegram_document(chosen: Telegram) -> dict[str, Any]:
    """The words of a telegram with their bits and units."""
    return {
        "number": chosen.number,
        "setpoints": _half(chosen.setpoints),
        "actuals": _half(chosen.actuals),
    }


def states_document() -> dict[str, dict[str, str]]:
    """Word and symbol of each state, by its name."""
    return {state.name: {"text": state.value, "symbol": symbol} for state, symbol in SYMBOLS.items()}


class PageParameters:
    """Parameters of the gateway with the record channel at ``address``; None: no channel for this machine."""

    def __init__(self, address: tuple[str, int] | None) -> None:
        self._address = address

    def read(self, do_id: int, text: str) -> list[dict[str, Any]]:
        """The elements of ``P922``, ``6041h``, ``1018h.1-4``, with the device's refusals; RequestError for another text."""
        try:
            target = parse_target(text)
        except GatewayError as error:
            raise RequestError("pnu", str(error)) from error
        with self._session(do_id) as session:
            return [_element(session, element) for element in session.read([target])]

    def dump(self, do_id: int) -> dict[str, Any]:
        """As ``pdgw param dump`` writes it."""
        with self._session(do_id) as session:
            return read_all(session)[0].model_dump(mode="json")

    def names(self, do_id: int) -> list[dict[str, Any]]:
        """Parameters of the drive object, by number and name."""
        with self._session(do_id) as session:
            return [{"pnu": address_text(pnu), "name": session.name_and_unit(pnu, 0)[0]} for pnu in session.pnus()]

    @contextmanager
    def _session(self, do_id: int) -> Iterator[Session]:
        if self._address is None:
            raise GatewayError('transport type = "profinet": only the controller can read parameters, the page cannot')
        with ParameterClient(self._address, do_id) as client:
            yield Session(client)


def _element(session: Session, element: Element) -> dict[str, Any]:
    name, unit = session.name_and_unit(element.pnu, element.subindex)
    said = {
        "parameter": address_text(element.pnu, element.subindex or None),
        "name": name,
        "unit": unit,
        "meaning": meaning(element, encoder=session.is_encoder),
    }
    return element.document() | said
