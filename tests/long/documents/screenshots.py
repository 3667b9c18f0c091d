"""``python -m tests.long.documents.screenshots FOLDER``: screenshots of the page for the documents.

A simulated gateway runs in virtual time. Needs the extras ``web`` and ``browser``, and Debian's chromium.
"""

from __future__ import annotations

import copy
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from playwright.sync_api import sync_playwright

from pdgw.gateway.service.status import explanation, fault_status, snapshot
from pdgw.gateway.trace.recorder import FlightRecorder
from pdgw.peers.world import Plc
from pdgw.tools.recording.trace_keeper import captured
from pdgw.tools.web.parameters import PageParameters
from pdgw.tools.web.status.watch import Watch
from tests.support.gateways.daemon import axis, configuration, running, world_of
from tests.support.page import in_background

_SHOTS = {"axes": "axes", "axis": "axis/1", "axis-dark": "axis/3", "telephone": "axes", "telephone-dark": "axis/1"}
_TELEPHONE, _DESK = {"width": 390, "height": 844}, {"width": 1180, "height": 860}


def main(folder: Path) -> None:
    """Take the screenshots of three axes: the first has turned, the second is off, the third has no control by PLC."""
    axes = "".join(axis(n, telegram_number=number) for n, number in enumerate((1, 9, 1), 1))
    config = configuration(f"{axes}[trace]\n", can='[can]\ninterface = "virtual"\n[web]\nlisten = "127.0.0.1:0"\n')
    folder_of_trace = Path(tempfile.mkdtemp())
    with running(config, lambda d: d.services.append(FlightRecorder(d, folder_of_trace, "pictures"))) as daemon:
        plc = Plc(world_of(daemon), daemon)
        for index, word in enumerate((0x047E, 0x047E, 0x007F)):
            plc.set(index, {"STW1": word})
        plc.exchange(5)
        scene: Any = SimpleNamespace(
            status=lambda: copy.deepcopy(scene.shown),
            shown=snapshot(daemon),
            explanation=lambda do_id: explanation(daemon, [o for o in daemon.objects if do_id in (None, o.do_id)]),
            faults=lambda do_id: next(fault_status(o) for o in daemon.objects if o.do_id == do_id),
        )
        with in_background(Watch(config, scene), PageParameters(None), captured) as port, sync_playwright() as engine:
            browser = engine.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])
            for name, view in _SHOTS.items():
                scene.shown = snapshot(daemon)
                size = _TELEPHONE if "telephone" in name else _DESK
                tab = browser.new_page(viewport=size, color_scheme="dark" if "dark" in name else "light")
                tab.goto(f"http://127.0.0.1:{port}/#/{view}")
                tab.get_by_text("live, PLC connected").wait_for()
                for percent in (0, 20, 60, -30, 80, 45):
                    tab.wait_for_timeout(1000)  # a curve has no text to wait for
                    plc.exchange(1, STW1=0x047F, NSOLL_A=percent * 0x4000 // 100)
                    scene.shown = snapshot(daemon)
                tab.wait_for_timeout(1000)
                tab.screenshot(path=folder / f"{name}.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
