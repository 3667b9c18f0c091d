"""The PLC simulator in a terminal: a child process runs the PLC, this one draws its output and passes keys to it."""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Sequence
from typing import IO, Any

from rich.console import Group, RenderableType
from rich.live import Live
from rich.text import Text

from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.configuration.defaults import STATUS_PORT
from pdgw.gateway.service.status_client import fetch
from pdgw.peers.plc.exchange.following import line_of, tables
from pdgw.tools.options import read_keys, single_keys

_MESSAGES_MAX = 5
"""Number of messages on the screen."""
_REASONS_S = 1.0
_STOP_S = 10


class Window:
    """The content of the screen."""

    def __init__(self) -> None:
        self.results: list[dict[str, Any]] = []
        self.reasons: Sequence[str] = ()
        self._messages: deque[str] = deque(maxlen=_MESSAGES_MAX)
        self._snapshot: dict[str, Any] | None = None

    def take(self, document: dict[str, Any]) -> None:
        """Add a line of output from the PLC process."""
        self._snapshot = document.get("snapshot", self._snapshot)
        if "result" in document:
            self.results.append(document["result"])
        if text := line_of(document):
            self._messages.append(text)

    def drawing(self) -> RenderableType:
        """The messages come first: a small terminal cuts off the last words of a telegram instead."""
        shown = [] if self._snapshot is None else [tables(self._snapshot, self.reasons)]
        return Group(*(Text(text) for text in self._messages), *shown)


def reasons_of(document: dict[str, Any]) -> list[str]:
    """Why each axis is not in operation, in the order of the frame, from the gateway's status."""
    return [str(item.get("reason") or "") for item in (*document["axes"], *document["encoders"])]


def watch(arguments: Sequence[str], *, interactive: bool, local: bool) -> tuple[list[dict[str, Any]], int]:
    """Run ``pdgw`` with these arguments and draw its output. Return the results of its expectations and its exit status.

    ``local``: the gateway is on this machine, and its status (at the usual port) shows why an axis does not move.
    """
    window = Window()
    process = subprocess.Popen(
        [sys.executable, "-m", "pdgw", *arguments, "--progress"],
        stdin=subprocess.PIPE if interactive else subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
    )
    before = signal.signal(signal.SIGTERM, lambda *_: process.terminate())
    try:
        with single_keys() if interactive else contextlib.nullcontext(), Live(refresh_per_second=10) as live:
            if process.stdin is not None:
                threading.Thread(target=_hand_on, args=(process.stdin,), daemon=True).start()
            if local:
                threading.Thread(target=_ask, args=(window, process), daemon=True).start()
            assert process.stdout is not None
            for line in process.stdout:
                window.take(json.loads(line))
                live.update(window.drawing())
    except KeyboardInterrupt:
        pass  # the child gets the signal, too, and ends
    finally:
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(_STOP_S)
        if process.poll() is None:
            process.kill()
            process.wait()
        signal.signal(signal.SIGTERM, before)
    return window.results, process.returncode


def _hand_on(target: IO[str]) -> None:
    """Pass keys to the PLC process until it ends."""
    with contextlib.suppress(OSError, ValueError):
        while keys := read_keys():
            target.write(keys)
            target.flush()
        target.close()


def _ask(window: Window, process: subprocess.Popen[str]) -> None:
    while process.poll() is None:
        try:
            window.reasons = reasons_of(fetch(STATUS_PORT))
        except GatewayError:
            window.reasons = ()
        time.sleep(_REASONS_S)
