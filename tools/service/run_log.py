"""The log of ``pdgw run``. It does not delay the gateway and does not run longer than it.

A thread writes it from a bounded queue. Lines that a full disk or a blocked pipe does not accept are counted and dropped.
"""

from __future__ import annotations

import logging
import logging.handlers
import queue
import select
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path

from rich.console import Console
from rich.logging import RichHandler

from pdgw.ds301.counters import Counters
from pdgw.gateway.base.errors import writing
from pdgw.tools.recording import recorder
from pdgw.tools.service.log_format import LogFormat, LogLevel, formatter

log = logging.getLogger("gateway")

_LINES = 10_000
"""Capacity of the queue of log records."""
_PATIENCE_MS = 1000
_LONGEST_LINE = 2000
"""Longest line on standard error: a pipe that is ready accepts this much at once."""


class _ToQueue(logging.handlers.QueueHandler):
    """Drops a record when the queue is full; never waits."""

    def __init__(self, records: queue.Queue[logging.LogRecord]) -> None:
        super().__init__(records)
        self.lost = 0

    def enqueue(self, record: logging.LogRecord) -> None:
        try:
            self.queue.put_nowait(record)
        except queue.Full:
            self.lost += 1


class _FromQueue(logging.handlers.QueueListener):
    """Its end waits for a limited time."""

    def __init__(self, records: queue.Queue[logging.LogRecord], handler: logging.Handler) -> None:
        super().__init__(records, handler)
        self._records = records
        self.left = 0
        """Lines still waiting at the end."""

    def handle(self, record: logging.LogRecord) -> None:
        try:
            super().handle(record)
        except OSError:
            # The folder of the log file is missing or its disk is full. The next line tries again.
            for handler in self.handlers:
                handler.handleError(record)

    def enqueue_sentinel(self) -> None:
        self._records.put(self._sentinel, timeout=recorder.END_S)  # type: ignore[attr-defined]

    def stop(self) -> None:
        thread: threading.Thread | None = self._thread
        if thread is None:
            return
        try:
            self.enqueue_sentinel()
        except queue.Full:
            self.left = self._records.qsize()
            return  # the output is blocked: the thread ends with the process
        recorder.wait_for_end(thread)
        self._thread = None
        if thread.is_alive():
            self.left = self._records.qsize()  # including the sentinel, which counts as the line being written


class _WhenReady(logging.Filter):
    """Passes a record only when the file descriptor is ready: a blocked pipe would block the thread and the process."""

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
            half = _LONGEST_LINE // 2  # keep the end, too: the last line of a traceback names the error
            record.msg, record.args = f"{text[:half]} ... {text[-half:]}", None
        return True


class RunLog:
    """The gateway's log on standard error (coloured on a terminal) or in a file. Other libraries log warnings only."""

    def __init__(self, level: LogLevel, file: Path | None, log_format: LogFormat = LogFormat.AUTO) -> None:
        self._failed = 0
        self._ready_filter: _WhenReady | None = None
        self._handler = self._open(file, log_format)
        records: queue.Queue[logging.LogRecord] = queue.Queue(_LINES)
        self._listener = _FromQueue(records, self._handler)
        self._to_listener = _ToQueue(records)
        # Do not format on the queue's side: basicConfig would add its own format before that of the listener.
        self._to_listener.setFormatter(logging.Formatter("%(message)s"))
        logging.basicConfig(level=logging.ERROR, handlers=[self._to_listener], force=True)
        logging.getLogger("canopen").setLevel(logging.CRITICAL)  # the drive client reports what the user needs
        log.setLevel(level.value.upper())
        self._listener.start()

    def _open(self, file: Path | None, log_format: LogFormat) -> logging.Handler:
        handler: logging.Handler
        if file is not None:
            with writing(f"--log-file {file}"):
                handler = logging.handlers.WatchedFileHandler(file, encoding="utf-8")
        elif sys.stderr.isatty() and log_format is LogFormat.AUTO:
            handler = RichHandler(console=Console(stderr=True), show_path=False, log_time_format="%m-%d %H:%M:%S.%f")
        else:
            handler = logging.StreamHandler()
        if not isinstance(handler, RichHandler):
            handler.setFormatter(formatter(log_format, to_file=file is not None))
        if file is None and hasattr(select, "poll"):
            self._ready_filter = _WhenReady(sys.stderr.fileno())
            handler.addFilter(self._ready_filter)
        handler.handleError = self._count_failure  # type: ignore[method-assign]
        return handler

    def _count_failure(self, record: logging.LogRecord) -> None:
        self._failed += 1

    @property
    def lost(self) -> int:
        """Lines dropped because the output was blocked or too slow."""
        taken = 0 if self._ready_filter is None else self._ready_filter.lost
        return self._failed + self._to_listener.lost + self._listener.left + taken

    def count_in(self, counters: Counters) -> None:
        """Count the dropped lines in the gateway's counters."""
        counters.add(
            "log",
            "lost",
            "lines",
            "not written: the disk is full, the pipe has no reader, or too many lines",
            lambda: self.lost,
        )

    @property
    def reopens(self) -> bool:
        """Whether there is a log file to reopen."""
        return isinstance(self._handler, logging.FileHandler)

    def reopen(self) -> None:
        """Continue in a new file of the same name, after the old one was renamed (SIGHUP)."""
        handler = self._handler
        if isinstance(handler, logging.FileHandler):
            try:
                handler.close()  # the next line opens it again
            except OSError:  # buffered lines that a full disk did not accept
                self._failed += 1
            log.info("log file opened again")

    def stop(self) -> None:
        """Write the waiting lines, for two seconds at most."""
        self._listener.stop()


Stop = Callable[[], None]


def on_signals(stop: Stop, run_log: RunLog) -> dict[str, Callable[[], None]]:
    """The action for each signal, by name. No signal ends the process without the stop sequence."""

    # As with nohup: the end of the terminal does not end the gateway.
    kept = hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN

    def hang_up() -> None:
        if run_log.reopens:
            run_log.reopen()
        elif not kept:
            stop()  # the terminal is closed

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
