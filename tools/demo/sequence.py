"""Run a chapter of the demo: start its processes, follow its scenario, collect the results."""

from __future__ import annotations

import contextlib
import json
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from pdgw.gateway.base.errors import GatewayError, writing
from pdgw.gateway.configuration.toml_file import toml_text
from pdgw.peers.bus import INTERFACE, ServedBus
from pdgw.tools.demo.chapters import Chapter
from pdgw.tools.demo.links import RECORD, DemoLink, free_ports
from pdgw.tools.demo.plot import plot
from pdgw.tools.recording.recorder import CAPTURE
from pdgw.tools.recording.recordings import Part, known_from, look_ahead, write_page

CHAPTER_LIMIT_S = 300
_STOP_S = 60
"""Longest time for a process to end, also on a busy machine."""
_EVIDENCE = ("report.json", "plc.json", "plc.pcap", "trace.png", "trace.html")


@dataclass
class Outcome:
    """The result of the demo."""

    report: dict[str, Any] = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        return bool(self.report.get("passed"))


class Demo:
    """Runs one chapter and writes its files to ``out``. ``show`` gets each progress document of the PLC.

    ``link``: between PLC and gateway. ``scenario``: replaces that of the chapter.
    """

    def __init__(
        self,
        chapter: Chapter,
        out: Path,
        show: Callable[[dict[str, Any]], None],
        link: DemoLink,
        scenario: Path | None = None,
    ) -> None:
        self.chapter = chapter
        self.out = out
        self.show = show
        self.link = link
        self.scenario = scenario or chapter.scenario
        self._processes: dict[str, subprocess.Popen[str]] = {}
        self._logs: list[IO[str]] = []

    def run(self) -> Outcome:
        """Run the scenario. GatewayError with the end of its log when a process dies."""
        try:
            self.out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise GatewayError(f"{self.out}: cannot be created: {error.strerror}") from error
        for name in _EVIDENCE:
            (self.out / name).unlink(missing_ok=True)  # so that a failed run leaves no files of an earlier success
        started = time.monotonic()
        with ServedBus() as bus, contextlib.closing(self.link):
            try:
                self._start(bus.channel)
                self._follow()
            finally:
                codes = self._stop()
        report = json.loads((self.out / "plc.json").read_text(encoding="utf-8"))
        (self.out / "plc.json").unlink()
        report["duration_s"] = round(time.monotonic() - started, 2)
        report["exit_codes"] = codes
        if report["passed"] and codes["plc"]:
            raise GatewayError(f"the PLC simulator ended with status {codes['plc']}: {self._tail('plc')}")
        report["passed"] = report["passed"] and codes["gateway"] == 0 and codes["devices"] == 0
        self._write("report.json", json.dumps(report, indent=2))
        config, capture = self.out / "gateway.toml", self.out / self.link.capture
        plot(self.chapter, capture, config, report["begin_s"], report["notes"], self.out / "trace.png")
        self._write_page()
        return Outcome(report)

    def _write(self, name: str, text: str) -> Path:
        path = self.out / name
        with writing(path):
            path.write_text(text, encoding="utf-8")
        return path

    def _write_page(self) -> None:
        """Write the gateway's recording as an HTML page."""
        files = [str(self.out / RECORD / CAPTURE)]
        opening = look_ahead(files, known_from(self.out / "gateway.toml", [], []), None, lambda _: None)
        write_page(opening, Part(), self.out / "trace.html")

    def _start(self, channel: str) -> None:
        (control,) = free_ports(socket.SOCK_STREAM, 1)
        self.link.open(control)
        can = {"interface": INTERFACE, "channel": channel}
        config = self._write("gateway.toml", toml_text(self.chapter.gateway(can, self.link.transport)))
        devices = self._write("devices.toml", toml_text(self.chapter.devices(can, control)))
        self._spawn("devices", "sim", "bus", str(devices))
        self._spawn("gateway", "run", str(config), "--record", str(self.out / RECORD))
        self._spawn(
            "plc",
            *("sim", "plc", str(self.scenario), "--progress", *self.link.plc(self.out)),
            *("--cycle-ms", str(self.chapter.cycle_ms), "--json", str(self.out / "plc.json")),
        )

    def _spawn(self, name: str, *arguments: str) -> None:
        log = (self.out / f"{name}.log").open("w", encoding="utf-8")
        self._logs.append(log)
        command = [sys.executable, "-m", "pdgw", *arguments]
        self._processes[name] = subprocess.Popen(
            self.link.command(*command) if name == "plc" else command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE if name == "plc" else log,
            stderr=log,
            text=True,
        )

    def _follow(self) -> None:
        plc = self._processes["plc"]
        expired = threading.Event()

        def expire() -> None:
            expired.set()
            plc.kill()

        watchdog = threading.Timer(CHAPTER_LIMIT_S, expire)
        watchdog.start()
        try:
            if plc.stdout is not None:
                for line in plc.stdout:
                    self.show(json.loads(line))
                    self._check_others()
            plc.wait()
        finally:
            watchdog.cancel()
        self._check_others()
        if expired.is_set():
            raise GatewayError(f"the demo took longer than {CHAPTER_LIMIT_S} s; its logs are in {self.out}")
        if plc.returncode not in {0, 1} or not (self.out / "plc.json").exists():
            raise GatewayError(f"the PLC simulator ended with status {plc.returncode}: {self._tail('plc')}")

    def _check_others(self) -> None:
        for name in ("gateway", "devices"):
            status = self._processes[name].poll()
            if status is not None:
                raise GatewayError(f"the {name} process ended with status {status}: {self._tail(name)}")

    def _tail(self, name: str) -> str:
        text = (self.out / f"{name}.log").read_text(encoding="utf-8").strip()
        return text[-600:] if text else "its log is empty"

    def _stop(self) -> dict[str, int]:
        """End the processes: first the PLC, then the gateway, which stops the drives, then the devices."""
        try:
            for name in ("plc", "gateway", "devices"):
                process = self._processes.get(name)
                if process is None:
                    continue
                if process.poll() is None:
                    process.send_signal(signal.SIGTERM)
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(_STOP_S)
        finally:  # also after a second Ctrl-C
            for process in self._processes.values():
                if process.poll() is None:
                    process.kill()
                    process.wait()
                if process.stdout is not None:
                    process.stdout.close()
            for log in self._logs:
                log.close()
        return {name: process.returncode for name, process in self._processes.items()}
