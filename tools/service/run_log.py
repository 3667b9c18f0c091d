"""What ``pdgw run`` writes beside its work: the log and the record of CAN frames. Neither ever holds up or outlives the gateway.

Both are written by threads of their own from bounded queues. What a full disk, or a pipe nobody reads, does not take is counted
and lost.
"""

from __future__ import annotations

import copy
import logging
import logging.handlers
import queue
import select
import signal
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import can
from rich.console import Console
from rich.logging import RichHandler

from pdgw.ds301.counters import Counters
from pdgw.gateway.errors import GatewayError
from pdgw.recording import background_writer
from pdgw.recording.background_writer import BackgroundWriter
from pdgw.tools.service.log_format import Bundle, LogFormat, LogLevel, formatter

log = logging.getLogger("gateway")

_LINES = 10_000
"""Log records that may wait."""
_LOOK_S = 1.0
"""So often the bundle of repeated lines is looked at while nothing comes."""
_PATIENCE_MS = 1000
_LONGEST_LINE = 2000
"""Of a log on standard error: a pipe that has room takes so much at once."""


class _ToQueue(logging.handlers.QueueHandler):
    """Never waits for a place in the queue."""

    def __init__(self, records: queue.Queue[logging.LogRecord]) -> None:
        super().__init__(records)
        self.lost = 0

    def enqueue(self, record: logging.LogRecord) -> None:
        try:
            self.queue.put_nowait(record)
        except queue.Full:
            self.lost += 1


class _FromQueue(logging.handlers.QueueListener):
    """Bundles lines that repeat themselves; its end waits for a limited time."""

    def __init__(self, records: queue.Queue[logging.LogRecord], handler: logging.Handler) -> None:
        super().__init__(records, handler)
        self._records = records
        self._bundle = Bundle()
        self.left = 0
        """Lines that were still waiting at the end."""

    def dequeue(self, block: bool) -> logging.LogRecord:
        while True:
            try:
                return self._records.get(block, timeout=_LOOK_S)
            except queue.Empty:
                if not block:
                    raise
                self._write(self._bundle.due(time.time()))

    def handle(self, record: logging.LogRecord) -> None:
        self._write(self._bundle.take(record))

    def _write(self, records: list[logging.LogRecord]) -> None:
        for record in records:
            try:
                super().handle(record)
            except OSError:
                # The folder of the log file is not there, or its disk is full: it is looked for at the next line.
                for handler in self.handlers:
                    handler.handleError(record)

    def enqueue_sentinel(self) -> None:
        self._records.put(self._sentinel, timeout=background_writer.END_S)  # type: ignore[attr-defined]

    def stop(self) -> None:
        thread: threading.Thread | None = self._thread
        if thread is None:
            return
        try:
            self.enqueue_sentinel()
        except queue.Full:
            self.left = self._records.qsize()
            return  # nothing is taken any more: the thread ends with the process
        background_writer.wait_for_end(thread)
        self._thread = None
        if thread.is_alive():
            self.left = self._records.qsize()  # with the sentinel, which stands for the line that is being written
        else:
            self._write(self._bundle.flush())


class _Taken(logging.Filter):
    """Passes a record when the file descriptor takes it: a pipe nobody reads would hold the thread, and the process, for ever."""

    def __init__(self, descriptor: int) -> None:
        super().__init__()
        self._poll = select.poll()
        self._poll.register(descriptor, select.POLLOUT)
        self._stuck = False
        self.lost = 0

    def filter(self, record: logging.LogRecord) -> bool:
        self._stuck = not self._poll.poll(0 if self._stuck else _PATIENCE_MS)
        if self._stuck:
            self.lost += 1
            return False
        text = record.getMessage()
        if len(text) > _LONGEST_LINE:
            half = _LONGEST_LINE // 2  # what a traceback is about is its last line
            record.msg, record.args = f"{text[:half]} ... {text[-half:]}", None
        return True


class RunLog:
    """The gateway's log on standard error (coloured on a terminal) or in a file; other libraries only warn."""

    def __init__(self, level: LogLevel, file: Path | None, log_format: LogFormat = LogFormat.AUTO) -> None:
        self._failed = 0
        self._taken: _Taken | None = None
        self._handler = self._open(file, log_format)
        records: queue.Queue[logging.LogRecord] = queue.Queue(_LINES)
        self._listener = _FromQueue(records, self._handler)
        self._to_listener = _ToQueue(records)
        # The queue's side must not format: basicConfig would give it a format of its own, in front of the listener's.
        self._to_listener.setFormatter(logging.Formatter("%(message)s"))
        logging.basicConfig(level=logging.ERROR, handlers=[self._to_listener], force=True)
        logging.getLogger("canopen").setLevel(logging.CRITICAL)  # the drive client reports what concerns the user
        log.setLevel(level.value.upper())
        self._listener.start()

    def _open(self, file: Path | None, log_format: LogFormat) -> logging.Handler:
        handler: logging.Handler
        if file is not None:
            try:
                handler = logging.handlers.WatchedFileHandler(file, encoding="utf-8")
            except OSError as error:
                raise _unwritable("--log-file", file, error) from error
        elif sys.stderr.isatty() and log_format is LogFormat.AUTO:
            handler = RichHandler(console=Console(stderr=True), show_path=False, log_time_format="%m-%d %H:%M:%S.%f")
        else:
            handler = logging.StreamHandler()
        if not isinstance(handler, RichHandler):
            handler.setFormatter(formatter(log_format, to_file=file is not None))
        if file is None and hasattr(select, "poll"):
            self._taken = _Taken(sys.stderr.fileno())
            handler.addFilter(self._taken)
        handler.handleError = self._count_failure  # type: ignore[method-assign]
        return handler

    def _count_failure(self, record: logging.LogRecord) -> None:
        self._failed += 1

    @property
    def lost(self) -> int:
        """Lines nobody took, or that came faster than they could be written."""
        taken = 0 if self._taken is None else self._taken.lost
        return self._failed + self._to_listener.lost + self._listener.left + taken

    def count_in(self, counters: Counters) -> None:
        """Show what was lost."""
        counters.add(
            "log",
            "lost",
            "lines",
            "not written: the disk is full, the pipe has no reader, or too many lines",
            lambda: self.lost,
        )

    @property
    def reopens(self) -> bool:
        """There is a file to open again."""
        return isinstance(self._handler, logging.FileHandler)

    def reopen(self) -> None:
        """Go on in a new file of the same name, after the old one was moved away (SIGHUP)."""
        handler = self._handler
        if isinstance(handler, logging.FileHandler):
            try:
                handler.close()  # the next line opens it again
            except OSError:  # what a full disk has not taken yet
                self._failed += 1
            log.info("log file opened again")

    def stop(self) -> None:
        """What waits is written, as far as it is taken within two seconds."""
        self._listener.stop()


def _unwritable(option: str, file: Path, error: OSError) -> GatewayError:
    return GatewayError(f"{option} {file}: cannot be written ({error.strerror or error})")


class CanRecorder:
    """Writes the frames of all networks to a file."""

    def __init__(self, file: Path) -> None:
        from pdgw.decoder.capture.canlog import candump_line  # noqa: PLC0415 (a gateway that records nothing starts without)

        try:
            self._file = file.open("w", encoding="ascii", errors="replace", buffering=1 << 16)
        except OSError as error:
            raise _unwritable("--can-log", file, error) from error
        self.writer: BackgroundWriter[can.Message] = BackgroundWriter(
            f"--can-log {file}", lambda message: self._file.write(candump_line(message)), self._file.close
        )

    def record(self, bus: str, message: can.Message) -> None:
        """Called in the loop, whose messages are used again: a copy is queued.

        Sent and received frames get the same name ``bus``: python-can names the channel in received ones only.
        """
        recorded = copy.copy(message)
        recorded.channel = bus
        self.writer.put(recorded)

    def stop(self) -> None:
        """As ``BackgroundWriter.stop``."""
        self.writer.stop()


Stop = Callable[[], None]


def on_signals(stop: Stop, run_log: RunLog) -> dict[str, Callable[[], None]]:
    """What each signal does, by its name: none ends the process without the stop sequence."""

    # As by nohup: the end of the terminal is not that of the gateway.
    kept = hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN

    def hang_up() -> None:
        if run_log.reopens:
            run_log.reopen()
        elif not kept:
            stop()  # the terminal is gone

    def ignore() -> None:
        log.info("signal ignored")

    return {
        "SIGINT": stop,
        "SIGTERM": stop,
        "SIGQUIT": stop,
        "SIGHUP": hang_up,
        "SIGUSR1": ignore,
        "SIGUSR2": ignore,
    }
