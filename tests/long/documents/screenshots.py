"""``python -m tests.long.documents.screenshots FOLDER``: screenshots of the page for the documents.

A simulated gateway runs in virtual time, a thread serves its page, and Chromium opens it: light and dark, desktop and phone.
Needs the extras ``web`` and ``browser``, and Debian's chromium.
"""

from __future__ import annotations

import copy
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from pdgw.durations import SECOND
from pdgw.extras import missing
from pdgw.gateway.assembly import build_gateway
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.file import parse_config
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.service.status import explanation, fault_status, snapshot
from pdgw.gateway.trace.recorder import FlightRecorder
from pdgw.peers.world import Plc, World
from pdgw.profidrive.signals import signal
from pdgw.recording.trace_file import captured
from pdgw.web.parameters import PageParameters
from pdgw.web.run import in_background
from pdgw.web.status.watch import Watch

_AXES = {"spindle": 1, "slide": 9, "conveyor": 1}
"""Telegrams by axis name."""
_OFF, _ON = 0x047E, 0x047F
_WITHOUT_CONTROL = 0x007F
_SPEEDS = (20, 60, -30, 80, 45)
"""Speeds of axis 1 in percent, a few seconds each."""
_PATIENCE_MS = 60_000
_DRAWN_MS = 1000
"""Time to draw a curve, which has no text to wait for."""
_PATIENCE_NS = 10 * SECOND
DESK, TELEPHONE = {"width": 1180, "height": 860}, {"width": 390, "height": 844}
SHOTS = (
    ("axes", "#/axes", DESK, "light"),
    ("axis", "#/axis/1", DESK, "light"),
    ("axis-dark", "#/axis/3", DESK, "dark"),
    ("telephone", "#/axes", TELEPHONE, "light"),
    ("telephone-dark", "#/axis/1", TELEPHONE, "dark"),
)
"""File name, view, size and colours of each screenshot."""


def configuration() -> GatewayConfig:
    """Three axes and an encoder on the shaft of the first."""
    axes = "".join(
        f'[[axis]]\nname = "{name}"\ndo_id = {n}\nnode_id = {n}\ntelegram = {number}\nsimulate = true\n'
        for n, (name, number) in enumerate(_AXES.items(), 1)
    )
    return parse_config(
        'name = "press line 3"\n[can]\ninterface = "virtual"\nchannel = "pictures"\nbitrate = 1000000\n'
        f'[web]\nlisten = "127.0.0.1:0"\n{axes}'
        '[[encoder]]\ndo_id = 4\nnode_id = 4\ntelegram = 83\nsimulate = true\nmotion = "shaft=1"\n'
    )


class Scene:
    """Axis 1 turns in both directions, axis 2 is off, axis 3 has no control by PLC. ``Watch`` gets its answers at the end."""

    def __init__(self, config: GatewayConfig, directory: Path) -> None:
        self._world = World(0)
        self._world.simulate(config)
        self._daemon = build_gateway(config, self._world)
        self._daemon.services.append(FlightRecorder(self._daemon, directory, "pictures"))
        self._plc = Plc(self._world, self._daemon)
        self._daemon.start()

    def play(self) -> None:
        """Run from the start of the gateway until axis 1 has turned for some time."""
        for index, word in enumerate((_OFF, _OFF, _WITHOUT_CONTROL)):
            self._plc.set(index, {"STW1": word})
        self._plc.exchange(3, 3, STW2_ENC=signal("STW2_ENC").word("CONTROL_BY_PLC"))
        self._plc.exchange(2, STW1=_ON)
        for percent in _SPEEDS:
            self._plc.exchange(3, NSOLL_A=signal("NSOLL_A").raw(percent))

    def end(self) -> None:
        """Stop the drives."""
        self._daemon.stop()
        self._world.loop.until(self._daemon.stopped.is_set, "the end of the daemon", _PATIENCE_NS)

    def status(self) -> dict[str, Any]:
        return copy.deepcopy(snapshot(self._daemon))

    def explanation(self, do_id: int | None) -> list[dict[str, Any]]:
        return explanation(self._daemon, [item for item in self._daemon.objects if do_id in (None, item.do_id)])

    def faults(self, do_id: int) -> list[dict[str, Any]]:
        return next(fault_status(item) for item in self._daemon.objects if item.do_id == do_id)


@contextmanager
def served() -> Iterator[int]:
    """Serve the page of this gateway. Yield its port."""
    config = configuration()
    with tempfile.TemporaryDirectory() as directory:
        scene = Scene(config, Path(directory))
        try:
            scene.play()
            with in_background(Watch(config, scene), PageParameters(None), captured) as port:
                yield port
        finally:
            scene.end()


def take(folder: Path) -> None:
    """Write all screenshots. GatewayError when a requirement is missing."""
    try:
        from playwright.sync_api import sync_playwright  # noqa: PLC0415 (of an extra)
    except ModuleNotFoundError as error:
        raise GatewayError(missing("playwright", "the command")) from error
    chromium = shutil.which("chromium")
    if chromium is None:
        raise GatewayError("the pictures need Chromium: apt-get install chromium")
    with ExitStack() as at_end:
        port = at_end.enter_context(served())
        browser = at_end.enter_context(sync_playwright()).chromium.launch(
            executable_path=chromium, args=["--no-sandbox"] if os.getuid() == 0 else []
        )
        at_end.callback(browser.close)
        for name, view, size, colours in SHOTS:
            tab = browser.new_page(viewport=size, color_scheme=colours)
            tab.set_default_timeout(_PATIENCE_MS)
            tab.goto(f"http://127.0.0.1:{port}/{view}")
            tab.get_by_text("live, PLC connected").wait_for()
            if "axis/" in view:
                tab.wait_for_selector("#main canvas")
                tab.get_by_role("button", name="60 s" if size == DESK else "10 s").click()
                tab.wait_for_timeout(_DRAWN_MS)
            tab.screenshot(path=folder / f"{name}.png")
            tab.close()


def main() -> None:
    """Take all screenshots."""
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    take(folder)


if __name__ == "__main__":
    main()
