"""``pdgw`` processes without the start of a Python for each: forks of the tests' process, which has nearly everything loaded.

In the virtual machine four starts at the same time take minutes. What runs is the command line as it is installed, in a process
of its own with its own files and signals.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pdgw.__main__ import run
from pdgw.gateway.client import session
from pdgw.gateway.configuration import file
from pdgw.gateway.daemon import assembly
from pdgw.peers.plc import client
from pdgw.peers.simulation import console
from pdgw.tools.commands.commissioning import config
from pdgw.tools.commands.gateway import param, status
from pdgw.tools.commands.gateway import run as daemon
from pdgw.tools.commands.simulation import devices as sim_devices
from pdgw.tools.commands.simulation import plc as sim_plc
from pdgw.tools.service import run_log
from tests.support.buses import PATIENCE_S

LOADED = (config, param, sim_devices, sim_plc, status, daemon, assembly, client, file, run_log, console, session)
"""Commands load what they need when they are called: these have it before they are forked."""


class Forked:
    """A process that runs ``pdgw`` with these words; what it prints goes to ``log``. Ended whatever happens by ``forked``."""

    def __init__(self, words: tuple[str, ...], log: Path) -> None:
        self.log = log
        self.status: int | None = None
        keys, self._keys = os.pipe()
        output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        self._pid = os.fork()
        if self._pid == 0:
            _be(words, keys, output)
        os.close(keys)
        os.close(output)

    @property
    def text(self) -> str:
        """The output up to now."""
        return self.log.read_text(errors="replace")

    def type(self, keys: str) -> None:
        os.write(self._keys, keys.encode())

    def signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self._pid, number)

    def poll(self) -> int | None:
        """Its exit status, None while it runs."""
        if self.status is None:
            pid, status = os.waitpid(self._pid, os.WNOHANG)
            if pid:
                self.status = os.waitstatus_to_exitcode(status)
        return self.status

    def wait(self, seconds: float) -> int:
        end = time.monotonic() + seconds
        while (status := self.poll()) is None:
            assert time.monotonic() < end, f"still runs: {self.text}"
            time.sleep(0.05)
        return status

    def close(self) -> None:
        os.close(self._keys)


def _be(words: tuple[str, ...], keys: int, output: int) -> None:
    """The child: never returns."""
    status = 1
    try:
        for descriptor, number in ((keys, 0), (output, 1), (output, 2)):
            os.dup2(descriptor, number)
        os.closerange(3, 1024)
        sys.stdin, sys.stdout, sys.stderr = open(0), open(1, "w", buffering=1), open(2, "w", buffering=1)  # noqa: SIM115
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL if number == signal.SIGTERM else signal.default_int_handler)
        logging.getLogger().handlers.clear()  # pytest's, whose files are closed
        sys.argv = ["pdgw", *words]
        run()
        status = 0
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:  # what Python would print at the end of a process
        sys.excepthook(*sys.exc_info())
    finally:
        sys.stdout.flush()
        os._exit(status)


@contextmanager
def forked(*words: str, log: Path) -> Iterator[Forked]:
    process = Forked(words, log)
    try:
        yield process
    finally:
        process.signal(signal.SIGTERM)
        try:
            process.wait(PATIENCE_S)
        except AssertionError:
            process.signal(signal.SIGKILL)
            process.wait(PATIENCE_S)
        process.close()
