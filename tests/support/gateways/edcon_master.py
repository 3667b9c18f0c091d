"""festo-edcon, a public PROFIdrive master, as the PLC of a gateway in virtual time: its own telegrams, bits and waits.

Its process data are little-endian. Whatever it waits for, each look at the inputs is a cycle, and its sleeps let cycles pass.
It is installed without the packages it pins (``pip install --no-deps festo-edcon==1.0.3``); where it is missing the tests skip.
"""

from __future__ import annotations

import importlib
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import pytest

from pdgw.base.durations import SECOND
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.profidrive.telegrams import TelegramHalf, telegram
from tests.support.gateways.daemon import Plc

_WAITS = ("edcon.utils.func_helpers", "edcon.edrive.telegram111_handler")
"""Modules of edcon that look at a clock."""
_HANDLERS = {1: "telegram1_handler", 9: "telegram9_handler", 102: "telegram102_handler", 111: "motion_handler"}
_CLASSES = {1: "Telegram1Handler", 9: "Telegram9Handler", 102: "Telegram102Handler", 111: "MotionHandler"}
_PATIENCE_CYCLES = 15_000


class _Com:
    """What edcon calls a communication driver."""

    def __init__(self, plc: Plc, number: int) -> None:
        self.plc = plc
        self.layout = telegram(number)
        self.cycles = 0
        self.closed = False
        """Its handler shuts the drive down once more when it is collected."""

    def start_io(self) -> None:
        """Wait for the first actual values."""
        self.plc.until(lambda: self.plc.endpoint.actuals[0] is not None, "actual values")

    def stop_io(self) -> None:
        """Nothing to do."""

    shutdown = stop_io

    def io_active(self) -> bool:
        return True

    def validate_selected_telegram(self, number: int) -> None:
        assert number == self.layout.number

    def send_io(self, data: bytes, nonblocking: bool = False) -> None:
        self.plc.endpoint.set(0, _decoded(self.layout.setpoints, data))
        self._cycle()

    def recv_io(self, nonblocking: bool = False) -> bytes:
        self._cycle()
        actuals = self.plc.endpoint.actuals[0]
        assert actuals is not None
        return b"".join(struct.pack("<" + item.type.char, actuals[item.name]) for item in self.layout.actuals.signals)

    def _cycle(self) -> None:
        if self.closed:
            return
        self.cycles += 1
        assert self.cycles < _PATIENCE_CYCLES, f"edcon waits for ever: {self.plc.endpoint.actuals}"
        self.plc.exchange()


def _decoded(half: TelegramHalf, data: bytes) -> dict[str, int]:
    """Its words by name; it leaves USER of telegram 111 out."""
    values: dict[str, int] = {}
    offset = 0
    for item in half.signals:
        if offset < len(data):
            (values[item.name],) = struct.unpack_from("<" + item.type.char, data, offset)
            offset += item.type.size
    return values


class _Clock:
    """``time`` for edcon."""

    def __init__(self, plc: Plc) -> None:
        self._plc = plc

    def time(self) -> float:
        return self._plc.loop.now() / SECOND

    def sleep(self, seconds: float) -> None:
        end = self._plc.loop.now() + round(seconds * SECOND)
        while self._plc.loop.now() < end:
            self._plc.exchange()


@contextmanager
def edcon_master(daemon: Daemon, number: int) -> Iterator[Any]:
    """Its handler of a telegram, connected; skips the test where edcon is not installed."""
    pytest.importorskip("edcon")
    plc = Plc(daemon, [number])
    module = importlib.import_module(f"edcon.edrive.{_HANDLERS[number]}")
    functions, handler_111 = (importlib.import_module(name) for name in _WAITS)
    # It looks fault numbers up among those of one maker's drives.
    texts = {"diagnosis_name": lambda code: f"fault {code}", "diagnosis_remedy": lambda _: []}
    with patch.object(functions, "time", _Clock(plc)), patch.multiple(handler_111, time=_Clock(plc), **texts):
        com = _Com(plc, number)
        handler = getattr(module, _CLASSES[number])(com)
        if number == 9:
            _complete(handler.telegram)
        try:
            yield handler
        finally:
            com.closed = True


def _complete(telegram9: Any) -> None:
    """Version 1.0.3 asks words of telegram 9 that only 111 has, and MDI_MOD by another name."""
    telegram9.pos_stw1 = SimpleNamespace(continuous_update=False)
    telegram9.mdi_mode = telegram9.mdi_mod
    telegram9.nist_b = 0
