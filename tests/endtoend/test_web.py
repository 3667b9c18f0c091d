"""The page as processes: started beside a gateway, frozen, flooded and killed while an axis turns; the PLC does not notice."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import threading
import urllib.request
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from pdgw.gateway.service.status_client import fetch
from tests.support.buses import PATIENCE_S, wait_for
from tests.support.gateways.socket_plc import SocketPlc
from tests.support.processes import PATIENT, free_tcp_port, free_udp_port, running

OFF, ON = 0x047E, 0x047F


class Plc(SocketPlc, threading.Thread):
    """Sends a frame in each cycle, whatever the test does meanwhile."""

    def __init__(self, port: int) -> None:
        SocketPlc.__init__(self, ("127.0.0.1", port), [1])
        threading.Thread.__init__(self, name="PLC", daemon=True)
        self.stopping = threading.Event()

    def run(self) -> None:
        with closing(self.socket):
            while not self.stopping.is_set():
                self.exchange()

    def value(self, name: str) -> int:
        return self.signal(0, name)


def page_of(process: int) -> int:
    """The process id of the page a gateway has started."""
    children = Path(f"/proc/{process}/task/{process}/children").read_text().split()
    (found,) = [int(child) for child in children if b"\0web\0" in Path(f"/proc/{child}/cmdline").read_bytes()]
    return found


@contextmanager
def exchanging(port: int) -> Iterator[Plc]:
    plc = Plc(port)
    plc.start()
    try:
        yield plc
    finally:
        plc.stopping.set()
        plc.join()


@pytest.mark.e2e
def test_a_page_that_is_frozen_flooded_and_killed_changes_nothing_for_the_plc(tmp_path: Path) -> None:
    cyclic, status, web = free_udp_port(), free_tcp_port(), free_tcp_port()
    config = tmp_path / "gateway.toml"
    config.write_text(
        f'[can]\ninterface = "virtual"\nchannel = "page"\n[web]\nlisten = "127.0.0.1:{web}"\n[transport]\n'
        f"cyclic_port = {cyclic}\nacyclic_port = {free_udp_port()}\nstatus_port = {status}\n"
        "cycle_time_ms = 40\nwatchdog_factor = 255\n"
        "[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = 1\nsimulate = true\n" + PATIENT
    )

    def answers() -> bool:
        with contextlib.suppress(OSError, ValueError):
            with urllib.request.urlopen(f"http://127.0.0.1:{web}/api/v1/status", timeout=PATIENCE_S) as answer:
                document = json.loads(answer.read())
            return bool(document["axes"][0]["state_id"] == "OBEYS" and not document["stale"])
        return False

    def counted(name: str) -> int:
        counters = fetch(status, PATIENCE_S)["counters"]
        return next(item["value"] for item in counters if (item["part"], item["name"]) == ("link", name))

    with running("run", str(config), "--web", log=tmp_path / "log") as gateway, exchanging(cyclic) as plc:
        plc.endpoint.set(0, {"STW1": OFF})
        wait_for(lambda: plc.value("ZSW1") & 0x4F == 0x01, "the drive")
        plc.endpoint.set(0, {"STW1": ON, "NSOLL_A": 0x2000})
        wait_for(lambda: plc.value("NIST_A") == 0x2000, "half speed")
        wait_for(answers, "the page")
        lost, accepted = counted("watchdog_expiries"), counted("accepted")
        page = page_of(gateway.pid)

        os.kill(page, signal.SIGSTOP)
        flood = [socket.create_connection(("127.0.0.1", web), timeout=PATIENCE_S) for _ in range(60)]
        for connection in flood:
            connection.sendall(b"GET /api/v1/objects/1/trace HTTP/1.1\r\nHost: localhost\r\n\r\n" * 10)
        wait_for(lambda: counted("accepted") > accepted + 50, "frames while the page is frozen and flooded")
        os.kill(page, signal.SIGCONT)
        wait_for(lambda: counted("accepted") > accepted + 100, "frames while the page works on the flood")
        for connection in flood:
            connection.close()
        wait_for(answers, "the page after the flood")
        os.kill(page, signal.SIGKILL)
        wait_for(lambda: counted("accepted") > accepted + 150, "frames after the page was killed")

        wait_for(
            lambda: plc.value("NIST_A") == 0x2000, "still half speed: an axis that was stopped would not turn again"
        )
        assert counted("watchdog_expiries") == lost
        assert fetch(status, PATIENCE_S)["axes"][0]["state_id"] == "OBEYS"
