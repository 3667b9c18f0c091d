"""``pdgw web``: serve the page of a gateway and its metrics, and publish to MQTT."""

from __future__ import annotations

import os
import signal
import sys
import threading
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pdgw.base.extras import EXTRA_OF, missing
from pdgw.gateway.base.errors import GatewayError
from pdgw.tools.service.log_format import FileOption, FormatOption, LevelOption, LogFormat, LogLevel

if TYPE_CHECKING:
    from pdgw.gateway.configuration.config import GatewayConfig

_NICE = 10
_ANYWHERE = "0.0.0.0"


def web(
    config: Annotated[Path, typer.Argument(help="The configuration file of the gateway.", show_default=False)],
    listen: Annotated[
        str | None, typer.Option(help="ADDRESS:PORT of the page (default: listen of the table web).")
    ] = None,
    log_level: LevelOption = LogLevel.INFO,
    log_file: FileOption = None,
    log_format: FormatOption = LogFormat.AUTO,
    attached: Annotated[bool, typer.Option("--attached", hidden=True, help="End when standard input closes.")] = False,
) -> None:
    """Serve the status of a running gateway to browsers, Prometheus and MQTT; read-only."""
    from pdgw.gateway.configuration.file import load_config
    from pdgw.tools.recording.trace_keeper import captured
    from pdgw.tools.service.run_log import RunLog
    from pdgw.tools.web.parameters import PageParameters

    _lower_priority()
    if attached:
        if hasattr(os, "sched_setaffinity"):  # do not inherit the processors that the gateway reserved for itself
            os.sched_setaffinity(0, range(os.cpu_count() or 1))
        threading.Thread(target=_end_with_input, daemon=True).start()
    chosen = load_config(config)
    if listen is not None:
        chosen = _listening(chosen, listen)
    with ExitStack() as at_end:
        run_log = RunLog(log_level, log_file, log_format)
        at_end.callback(run_log.stop)
        try:
            from pdgw.tools.web.app import serve

            serve(chosen, PageParameters(_record_channel(chosen)), captured)
        except ModuleNotFoundError as error:
            package = (error.name or "").partition(".")[0]
            if package not in EXTRA_OF:
                raise
            raise GatewayError(missing(package)) from error


def _lower_priority() -> None:
    """Yield the CPU to the exchange: drop an inherited real-time policy and lower the priority."""
    if hasattr(os, "sched_setscheduler") and os.sched_getscheduler(0) != os.SCHED_OTHER:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    if hasattr(os, "nice"):
        os.nice(max(0, _NICE - os.nice(0)))


def _end_with_input() -> None:
    while sys.stdin.read(1):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


def _listening(config: GatewayConfig, listen: str) -> GatewayConfig:
    from pydantic import ValidationError

    from pdgw.base.validation import problems
    from pdgw.gateway.configuration.web import WebConfig

    try:
        web_config = WebConfig.model_validate(config.web.model_dump() | {"listen": listen})
    except ValidationError as error:
        text = "\n".join(problem.text for problem in problems(error, WebConfig))
        raise GatewayError(f"--listen {listen}: {text}") from error
    return config.model_copy(update={"web": web_config})


def _record_channel(config: GatewayConfig) -> tuple[str, int] | None:
    """Address of the parameter channel on this machine. None on PROFINET, where only the controller reads records."""
    transport = config.transport
    if transport.type == "profinet":
        return None
    host = str(transport.listen)
    return "127.0.0.1" if host == _ANYWHERE else host, transport.acyclic_port
