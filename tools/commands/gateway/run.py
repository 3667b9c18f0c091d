"""``pdgw run``: the gateway as a foreground process or service."""

from __future__ import annotations

import faulthandler
import logging
import signal
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated

import typer

from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.configuration.defaults import SIMULATED_ENCODER_TELEGRAM
from pdgw.tools.options import only_with, telegrams_of_axes
from pdgw.tools.service.log_format import FileOption, FormatOption, LevelOption, LogFormat, LogLevel

if TYPE_CHECKING:
    from pdgw.base.validation import Problem
    from pdgw.gateway.configuration.config import GatewayConfig

log = logging.getLogger("gateway")


def _with_options(config: GatewayConfig, updates: dict[str, object]) -> GatewayConfig:
    from pydantic import ValidationError

    from pdgw.base.validation import problems
    from pdgw.gateway.configuration.config import GatewayConfig

    given = {key: value for key, value in updates.items() if value is not None}
    if not given:
        return config
    document = dict(config) | {"transport": config.transport.model_dump() | given}
    try:
        transport = GatewayConfig.model_validate(document).transport
    except ValidationError as error:
        raise GatewayError("\n".join(_option_problem(problem) for problem in problems(error, GatewayConfig))) from error
    return config.model_copy(update={"transport": transport})


def _option_problem(problem: Problem) -> str:
    """Describe a problem with the name of the command-line option instead of the configuration key."""
    section, *key = problem.location or ("",)
    if section != "transport" or not key or problem.names_key:
        return problem.text
    return f"--{str(key[-1]).replace('_', '-')} {problem.value.strip(chr(39))}: {problem.text}"


def _calls(action: Callable[[], None]) -> Callable[[int, FrameType | None], None]:
    return lambda *_: action()


def run(
    config: Annotated[Path | None, typer.Argument(help="Configuration file (TOML).", show_default=False)] = None,
    simulate: Annotated[
        bool, typer.Option("--simulate", help="Simulated devices beside the gateway; needs no file.")
    ] = False,
    telegram: Annotated[
        list[int] | None,
        typer.Option(
            help="Telegram of the simulated axes; repeat to give one for each (default: 1).", show_default=False
        ),
    ] = None,
    axes: Annotated[int | None, typer.Option(min=1, max=32, help="Number of simulated axes (default: 1).")] = None,
    encoders: Annotated[
        int | None, typer.Option(min=0, max=32, help="Number of simulated encoders, on the shafts of the axes.")
    ] = None,
    encoder_telegram: Annotated[
        int | None, typer.Option(help=f"Telegram of the simulated encoders (default: {SIMULATED_ENCODER_TELEGRAM}).")
    ] = None,
    listen: Annotated[str | None, typer.Option(help="Address towards the PLC.")] = None,
    peer: Annotated[str | None, typer.Option(help="Address of the PLC, needed when --listen is not loopback.")] = None,
    cyclic_port: Annotated[int | None, typer.Option(help="UDP port of the cyclic frames.")] = None,
    acyclic_port: Annotated[int | None, typer.Option(help="UDP port of the parameter channel.")] = None,
    cycle_time_ms: Annotated[float | None, typer.Option(help="Cycle time in milliseconds.")] = None,
    watchdog_factor: Annotated[
        int | None,
        typer.Option(help="Cycles without a frame until the PLC is lost; 250 with --simulate."),
    ] = None,
    status_port: Annotated[int | None, typer.Option(help="Loopback TCP port of `pdgw status`, 0 for none.")] = None,
    record: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Record both buses and the configuration here, for `pdgw timeline`; see --record-size: "
            "1 axis at 1 ms fills up to 1.4 GB an hour, 8 axes at 4 ms 1 GB.",
        ),
    ] = None,
    record_size: Annotated[int, typer.Option(min=1, help="Megabytes of a recording before another begins.")] = 256,
    record_files: Annotated[int, typer.Option(min=1, help="Full recordings to keep; the oldest are deleted.")] = 20,
    web: Annotated[
        bool, typer.Option("--web", help="Serve the page as `pdgw web` does, in a process of its own.")
    ] = False,
    log_level: LevelOption = LogLevel.INFO,
    log_file: FileOption = None,
    log_format: FormatOption = LogFormat.AUTO,
) -> None:
    """Run the gateway until SIGINT, SIGTERM or SIGQUIT; it stops and disables the drives before it ends.

    SIGHUP opens the log file again.
    """
    from pdgw.gateway.base.identity import beyond_measured, build_text
    from pdgw.gateway.base.run_directory import run_directory
    from pdgw.gateway.configuration.file import load_config, simulated
    from pdgw.gateway.daemon.assembly import build_gateway
    from pdgw.gateway.service import operating_system
    from pdgw.gateway.service.last_words import kept_last_words
    from pdgw.tools.service.child_processes import device_processes, page_process, trace_keeper
    from pdgw.tools.service.run_log import RunLog, on_signals

    if simulate == (config is not None):
        raise GatewayError("give either a configuration file or --simulate")
    read = None
    if config is None:
        chosen = simulated(
            telegrams_of_axes(telegram, axes), encoders or 0, encoder_telegram or SIMULATED_ENCODER_TELEGRAM
        )
    else:
        only_with("--simulate", {"--telegram": telegram, "--axes": axes})
        only_with("--simulate", {"--encoders": encoders, "--encoder-telegram": encoder_telegram})
        chosen = load_config(config)
        read = str(config.resolve()), config.stat().st_mtime
    chosen = _with_options(
        chosen,
        {
            "listen": listen,
            "peer": peer,
            "cyclic_port": cyclic_port,
            "acyclic_port": acyclic_port,
            "cycle_time_ms": cycle_time_ms,
            "watchdog_factor": watchdog_factor,
            "status_port": status_port,
        },
    )
    if sys.__stderr__ is not None:  # without a console, as on Windows
        faulthandler.enable(sys.__stderr__)  # on SIGABRT of a service manager's watchdog, print where each thread was
    with ExitStack() as at_end:
        words = at_end.enter_context(kept_last_words(chosen.transport.status_port))
        keep = at_end.enter_context(trace_keeper(chosen.trace))
        scheduling = operating_system.request(chosen.transport.cycle_time_ms)
        run_log = RunLog(log_level, log_file, log_format)
        at_end.callback(run_log.stop)
        log.info("pdgw %s; %s", build_text(), config or "simulated devices")
        if beyond := beyond_measured(len(chosen.axis), chosen.transport.cycle_time_ms):
            log.warning("%s", beyond)
        log.log(scheduling[0], "%s", scheduling[1])
        if record is not None and chosen.trace.directory is None and run_directory() is None:
            chosen = chosen.model_copy(update={"trace": chosen.trace.model_copy(update={"directory": record})})
        chosen = at_end.enter_context(device_processes(chosen))
        daemon = build_gateway(chosen, name="simulated" if config is None else config.stem)
        daemon.file = read
        at_end.callback(daemon.release)
        daemon.recall(words.text, words.origins)
        words.keep(daemon.loop, daemon.origins, daemon.last_event)
        run_log.count_in(daemon.loop.counters)
        if record is not None:
            from pdgw.tools.recording.recorder import Recording

            if daemon.recorder is None:
                raise GatewayError(
                    "--record: the flight recorder is missing, set [trace] enabled and a directory in RAM"
                )
            configuration = daemon.recorder.configuration
            recording = Recording(record, daemon.recorder.path, configuration, record_size << 20, record_files)
            at_end.callback(recording.stop)
            recording.count_in(daemon.loop.counters)
        if daemon.recorder is not None:
            keep(daemon.recorder.path)
        if web:
            at_end.enter_context(page_process(chosen))
        for name, action in on_signals(daemon.stop, run_log).items():
            if hasattr(signal, name):  # Windows lacks most of these signals
                signal.signal(getattr(signal, name), _calls(action))
        daemon.run()
