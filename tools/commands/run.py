"""``pdgw run``: the daemon."""

from __future__ import annotations

import copy
import logging
import logging.handlers
import queue
import signal
import sys
import threading
from contextlib import ExitStack
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Annotated

import can
import typer
from pdgw.gateway import realtime
from pdgw.gateway.config import CanConfig, GatewayConfig, load_config, simulated
from pdgw.gateway.daemon import Daemon
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.explain import Problem, problems
from pdgw.gateway.status import StatusServer
from pdgw.gateway.transport.acyclic import record_service
from pdgw.tools.beside import devices_beside
from pydantic import ValidationError
from rich.console import Console
from rich.logging import RichHandler

from pdgw import __version__

log = logging.getLogger("gateway")


class LogLevel(StrEnum):
    """Levels of ``--log-level``."""

    DEBUG = "debug"
    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


def set_up_logging(level: LogLevel, file: Path | None) -> logging.handlers.QueueListener:
    """The gateway's log on standard error (coloured on a terminal) or in a file; other libraries only warn.

    Written by a thread of its own (stop it at the end): a terminal that does not take it must not stop the drives.
    """
    handler: logging.Handler
    if file is not None:
        try:
            handler = logging.FileHandler(file, encoding="utf-8")
        except OSError as error:
            raise _unwritable("--log-file", file, error) from error
    elif sys.stderr.isatty():
        handler = RichHandler(console=Console(stderr=True), show_path=False, log_time_format="%H:%M:%S.%f")
    else:
        handler = logging.StreamHandler()
    if not isinstance(handler, RichHandler):
        handler.setFormatter(logging.Formatter("%(asctime)s.%(msecs)03d %(levelname)-7s %(message)s", "%H:%M:%S"))
    records: queue.SimpleQueue[logging.LogRecord] = queue.SimpleQueue()
    listener = logging.handlers.QueueListener(records, handler)
    to_listener = logging.handlers.QueueHandler(records)
    # The queue's side must not format: basicConfig would give it a format of its own, in front of the listener's.
    to_listener.setFormatter(logging.Formatter("%(message)s"))
    logging.basicConfig(level=logging.ERROR, handlers=[to_listener], force=True)
    logging.getLogger("canopen").setLevel(logging.CRITICAL)  # the drive client reports what concerns the user
    logging.getLogger("gateway").setLevel(level.value.upper())
    listener.start()
    return listener


def _unwritable(option: str, file: Path, error: OSError) -> GatewayError:
    return GatewayError(f"{option} {file}: cannot be written ({error.strerror or error})")


def _log_name(bus: CanConfig) -> str:
    """What a bus is called in the log: its channel where that is a plain name like can0."""
    return bus.channel if isinstance(bus.channel, str) and bus.channel.isidentifier() else bus.name


class CanRecorder:
    """Writes the frames of all networks to a file, on a thread of its own."""

    def __init__(self, file: Path) -> None:
        try:
            self._file = file.open("w", encoding="ascii", errors="replace", buffering=1 << 16)
        except OSError as error:
            raise _unwritable("--can-log", file, error) from error
        self._frames: queue.SimpleQueue[can.Message | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._write, name="CAN log", daemon=True)
        self._thread.start()

    def record(self, bus: str, message: can.Message) -> None:
        """Called on the cyclic and reading threads, whose messages are used again: a copy is queued.

        Sent and received frames get the same name ``bus``: python-can names the channel in received ones only.
        """
        recorded = copy.copy(message)
        recorded.channel = bus
        self._frames.put(recorded)

    def stop(self) -> None:
        """Everything recorded is in the file afterwards."""
        self._frames.put(None)
        self._thread.join()
        self._file.close()

    def _write(self) -> None:
        from pdgw.decoder.capture.canlog import candump_line  # noqa: PLC0415 (a gateway that records nothing starts without)

        while (message := self._frames.get()) is not None:
            self._file.write(candump_line(message))


def _with_options(config: GatewayConfig, updates: dict[str, object]) -> GatewayConfig:
    given = {key: value for key, value in updates.items() if value is not None}
    if not given:
        return config
    document = config.model_dump()
    document["transport"] |= given
    try:
        return GatewayConfig.model_validate(document)
    except ValidationError as error:
        raise GatewayError("\n".join(_told(problem) for problem in problems(error, GatewayConfig))) from error


def _told(problem: Problem) -> str:
    """A problem in the words of the command line."""
    section, *key = problem.location or ("",)
    if section != "transport" or not key or problem.names_key:
        return problem.text
    return f"--{str(key[-1]).replace('_', '-')} {problem.value.strip(chr(39))}: {problem.text}"


def run(
    config: Annotated[Path | None, typer.Argument(help="Configuration file (TOML).", show_default=False)] = None,
    simulate: Annotated[
        bool, typer.Option("--simulate", help="Simulated devices beside the gateway; needs no file.")
    ] = False,
    telegram: Annotated[int, typer.Option(help="Telegram of the simulated axes.")] = 1,
    axes: Annotated[int, typer.Option(min=1, max=32, help="Number of simulated axes.")] = 1,
    encoders: Annotated[
        int, typer.Option(min=0, max=32, help="Number of simulated encoders, on the shafts of the axes.")
    ] = 0,
    encoder_telegram: Annotated[int, typer.Option(help="Telegram of the simulated encoders.")] = 83,
    listen: Annotated[str | None, typer.Option(help="Address towards the PLC.")] = None,
    cyclic_port: Annotated[int | None, typer.Option(help="UDP port of the cyclic frames.")] = None,
    acyclic_port: Annotated[int | None, typer.Option(help="UDP port of the parameter channel.")] = None,
    cycle_time_ms: Annotated[float | None, typer.Option(help="Cycle time in milliseconds.")] = None,
    status_port: Annotated[int | None, typer.Option(help="Loopback TCP port of `pdgw status`, 0 for none.")] = None,
    can_log: Annotated[Path | None, typer.Option(help="Record all CAN frames here (candump format).")] = None,
    record: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Record both buses and the configuration here, for `pdgw timeline`."),
    ] = None,
    log_level: Annotated[LogLevel, typer.Option(help="What is logged.")] = LogLevel.INFO,
    log_file: Annotated[Path | None, typer.Option(help="Log here instead of standard error.")] = None,
) -> None:
    """Run the gateway until SIGINT or SIGTERM; the drives are stopped and disabled first."""
    if simulate == (config is not None):
        raise GatewayError("give either a configuration file or --simulate")
    chosen = simulated(telegram, axes, encoders, encoder_telegram) if config is None else load_config(config)
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
    refused = realtime.apply(chosen.realtime)
    with ExitStack() as at_end:
        at_end.callback(set_up_logging(log_level, log_file).stop)
        for text in refused:
            log.warning("%s", text)
        logging.getLogger("gateway").info("pdgw %s, %s", __version__, config or "simulated devices")
        recorder = CanRecorder(can_log) if can_log is not None else None
        if recorder is not None:
            at_end.callback(recorder.stop)
        recording = edge = None
        if record is not None:
            from pdgw.tools.recorder import Recorder, RecordingEdge  # noqa: PLC0415 (loads the decoder)

            recording = Recorder(record, chosen)
            at_end.callback(recording.stop)
            edge = RecordingEdge(recording)
        chosen = at_end.enter_context(devices_beside(chosen))
        daemon = Daemon(chosen, edge)
        at_end.callback(daemon.release)
        if recorder is not None:
            for bus in chosen.can:
                daemon.networks[bus.name].listeners.append(partial(recorder.record, _log_name(bus)))
        if recording is not None:
            for bus in chosen.can:
                daemon.networks[bus.name].listeners.append(partial(recording.frame, _log_name(bus)))
        daemon.services.append(record_service(daemon))
        if chosen.transport.status_port:
            daemon.services.append(StatusServer(daemon, chosen.transport.status_port))
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: daemon.stop())
        daemon.run()
