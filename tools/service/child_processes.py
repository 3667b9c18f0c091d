"""Child processes of a gateway, so that they do not delay its cycle: simulated devices, web page, trace keeper."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.environment import CanConfig, TraceConfig
from pdgw.gateway.configuration.file import config_text
from pdgw.gateway.service import operating_system

_VIRTUAL = "virtual"
"""python-can's bus inside one process. Between processes a bus server replaces it."""
_STOP_S = 5.0
_CHANNEL = "channel = "
_READY = "; commands: "


@contextlib.contextmanager
def device_processes(config: GatewayConfig) -> Iterator[GatewayConfig]:
    """Start the devices with ``simulate = true``, a process for each bus. Yield the configuration that reaches them.

    GatewayError when they cannot be started. They end with the context, or by themselves when this process dies.
    """
    if not any(axis.simulate for axis in config.axis) and not any(encoder.simulate for encoder in config.encoder):
        yield config
        return
    # Import the simulator only where it is used.
    from pdgw.peers.bus import INTERFACE  # noqa: PLC0415
    from pdgw.peers.simulation.config import bus_file, simulated_devices  # noqa: PLC0415

    with contextlib.ExitStack() as at_end:
        directory = Path(at_end.enter_context(tempfile.TemporaryDirectory(prefix="pdgw-")))
        started: list[tuple[CanConfig, subprocess.Popen[str]]] = []
        for bus in config.can:
            devices = simulated_devices(config, bus)
            if devices:
                file = directory / f"{len(started)}.toml"
                file.write_text(bus_file(bus, devices), encoding="utf-8")
                serve = ["--serve", "--port", "0"] if bus.interface == _VIRTUAL else []
                started.append((bus, at_end.enter_context(_process("sim", "bus", str(file), *serve))))
        reached: dict[str, CanConfig] = {}
        for bus, process in started:
            channel = _channel(bus, process)
            if bus.interface == _VIRTUAL:
                reached[bus.name] = CanConfig(interface=INTERFACE, channel=channel, name=bus.name, node_id=bus.node_id)
        yield config.model_copy(update={"can": tuple(reached.get(bus.name, bus) for bus in config.can)})


@contextlib.contextmanager
def page_process(config: GatewayConfig) -> Iterator[None]:
    """Start ``pdgw web`` for this configuration. It reports its own errors."""
    with tempfile.TemporaryDirectory(prefix="pdgw-") as directory:
        file = Path(directory) / "gateway.toml"
        file.write_text(config_text(config), encoding="utf-8")
        with _process("web", str(file)):
            yield


@contextlib.contextmanager
def _process(*command: str) -> Iterator[subprocess.Popen[str]]:
    """Start a child that ends when its standard input closes. It ignores Ctrl-C: drives must answer until they are at
    standstill.
    """
    with subprocess.Popen(
        [sys.executable, "-m", "pdgw", *command, "--attached"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        operating_system.usual(process.pid)
        try:
            yield process
        finally:
            assert process.stdin is not None
            with contextlib.suppress(OSError):  # the child may have ended already
                process.stdin.close()
            try:
                process.wait(_STOP_S)
            except subprocess.TimeoutExpired:
                process.kill()


@contextlib.contextmanager
def trace_keeper(trace: TraceConfig) -> Iterator[Callable[[Path], None]]:
    """Start the process that keeps parts of the flight recorder, if configured. Yield a function that passes it the ring's
    path.

    It starts before the gateway raises its priority, so that it does not inherit it. When the gateway ends, in any way, it
    first keeps what is pending, then ends by itself.
    """
    if not trace.enabled or not trace.keep or os.name != "posix":  # other systems have no ring files
        yield lambda path: None
        return
    options = [f"--on={item}" for item in trace.keep]
    process = subprocess.Popen(
        [sys.executable, "-m", "pdgw", "trace", "watch", "--attached", *options],
        stdin=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stdin is not None
    stdin = process.stdin

    def notify_keeper(path: Path) -> None:
        with contextlib.suppress(OSError):  # the child may have ended already
            stdin.write(f"{path}\n")
            stdin.flush()

    try:
        yield notify_keeper
    finally:
        with contextlib.suppress(OSError):
            stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(_STOP_S)


def _channel(bus: CanConfig, process: subprocess.Popen[str]) -> str:
    """Wait until the devices are powered. Return the channel of the served bus."""
    channel = ""
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith(_CHANNEL):
            channel = line.removeprefix(_CHANNEL).strip().strip('"')
        if _READY in line:
            return channel
    raise GatewayError(f"simulated devices of bus {bus.name}: start failed, see above")
