"""``pdgw run``: the daemon."""

from __future__ import annotations

import logging
import signal
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import can
import typer
from rich.console import Console
from rich.logging import RichHandler

from gateway.config import GatewayConfig, load_config, simulated
from gateway.daemon import Daemon
from gateway.errors import GatewayError
from gateway.status import StatusServer


class LogLevel(StrEnum):
    """Levels of ``--log-level``."""

    DEBUG = "debug"
    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


def set_up_logging(level: LogLevel, file: Path | None) -> None:
    """The gateway's log on standard error (coloured on a terminal) or in a file; other libraries only warn."""
    handler: logging.Handler
    if file is not None:
        handler = logging.FileHandler(file, encoding="utf-8")
    elif sys.stderr.isatty():
        handler = RichHandler(console=Console(stderr=True), show_path=False, log_time_format="%H:%M:%S.%f")
    else:
        handler = logging.StreamHandler()
    if not isinstance(handler, RichHandler):
        handler.setFormatter(logging.Formatter("%(asctime)s.%(msecs)03d %(levelname)-7s %(message)s", "%H:%M:%S"))
    logging.basicConfig(level=logging.ERROR, handlers=[handler], force=True)
    logging.getLogger("canopen").setLevel(logging.CRITICAL)  # the drive client reports what concerns the user
    logging.getLogger("gateway").setLevel(level.value.upper())


def _with_options(config: GatewayConfig, updates: dict[str, object]) -> GatewayConfig:
    given = {key: value for key, value in updates.items() if value is not None}
    if not given:
        return config
    document = config.model_dump()
    document["transport"] |= given
    return GatewayConfig.model_validate(document)


def run(
    config: Annotated[Path | None, typer.Argument(help="Configuration file (TOML).", show_default=False)] = None,
    simulate: Annotated[
        bool, typer.Option("--simulate", help="Simulated drives on a virtual bus; needs no file.")
    ] = False,
    telegram: Annotated[int, typer.Option(help="Telegram of the simulated axes.")] = 1,
    axes: Annotated[int, typer.Option(min=1, max=32, help="Number of simulated axes.")] = 1,
    listen: Annotated[str | None, typer.Option(help="Address towards the PLC.")] = None,
    cyclic_port: Annotated[int | None, typer.Option(help="UDP port of the cyclic frames.")] = None,
    acyclic_port: Annotated[int | None, typer.Option(help="UDP port of the parameter channel.")] = None,
    cycle_time_ms: Annotated[float | None, typer.Option(help="Cycle time in milliseconds.")] = None,
    status_port: Annotated[int | None, typer.Option(help="Loopback TCP port of `pdgw status`, 0 for none.")] = None,
    can_log: Annotated[Path | None, typer.Option(help="Record all CAN frames here (candump format).")] = None,
    log_level: Annotated[LogLevel, typer.Option(help="What is logged.")] = LogLevel.INFO,
    log_file: Annotated[Path | None, typer.Option(help="Log here instead of standard error.")] = None,
) -> None:
    """Run the gateway until SIGINT or SIGTERM; the drives are stopped and disabled first."""
    set_up_logging(log_level, log_file)
    if simulate == (config is not None):
        raise GatewayError("give either a configuration file or --simulate")
    try:
        chosen = simulated(telegram, axes) if config is None else load_config(config)
        chosen = _with_options(
            chosen,
            {
                "listen": listen,
                "cyclic_port": cyclic_port,
                "acyclic_port": acyclic_port,
                "cycle_time_ms": cycle_time_ms,
                "status_port": status_port,
            },
        )
    except ValueError as error:
        details = error.errors() if hasattr(error, "errors") else []
        raise GatewayError("; ".join(str(detail["msg"]) for detail in details) or str(error)) from error
    daemon = Daemon(chosen)
    recorder = None
    if can_log is not None:
        recorder = can.CanutilsLogWriter(can_log)
        for network in daemon.networks.values():
            network.listeners.append(recorder.on_message_received)
    if chosen.transport.status_port:
        daemon.services.append(StatusServer(daemon, chosen.transport.status_port))
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: daemon.stop())
    try:
        daemon.run()
    finally:
        if recorder is not None:
            recorder.stop()
