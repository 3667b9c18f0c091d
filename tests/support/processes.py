"""Real ``pdgw`` processes with what they print, stopped whatever happens."""

from __future__ import annotations

import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from pdgw.tools.demo.links import free_ports
from tests.support.buses import PATIENCE_S, process_checks, wait_for

COMMAND = (sys.executable, "-m", "pdgw")
PATIENT = "heartbeat_ms = 2000\ntpdo_event_ms = 2000\nsdo_timeout_ms = 5000\n"
"""Keys of an [[axis]] whose drive is not lost when its process does not get the processor for four seconds."""

_LOSS = re.compile(r"ERROR +PLC lost|fault 101")
_TRIES = 4
_END_OF_A_LOG = 2000
"""Length of each log's end in the message of a failed test, in characters."""
_PATIENCE_WITH_A_DEMO_S = 1800


def free_udp_port() -> int:
    (port,) = free_ports(socket.SOCK_DGRAM, 1)
    return port


def free_tcp_port() -> int:
    (port,) = free_ports(socket.SOCK_STREAM, 1)
    return port


def pdgw(*arguments: str, timeout: float = 600, text: str | None = None) -> subprocess.CompletedProcess[str]:
    """Run a command to its end."""
    return subprocess.run(
        [*COMMAND, *arguments], capture_output=True, text=True, timeout=timeout, input=text, check=False
    )


def demo_undisturbed(*words: str, log: Path, losses: int = 0) -> subprocess.CompletedProcess[str]:
    """Run ``pdgw demo``; repeat it if its gateway logs more than ``losses`` losses.

    A busy machine may pause a process for longer than the gateway's timeouts: the gateway then correctly reports a loss.
    """
    for _ in range(_TRIES):
        result = pdgw("demo", *words, timeout=_PATIENCE_WITH_A_DEMO_S)
        if not result.returncode or not log.exists() or len(_LOSS.findall(log.read_text())) <= losses:
            break
    return result


@contextmanager
def running(
    *arguments: str, log: Path, environment: Mapping[str, str] | None = None
) -> Iterator[subprocess.Popen[str]]:
    """A process in the background; its output goes to ``log``. It gets SIGTERM at the end if it still runs.

    A test that waits fails at once if the process has failed, for example because its port is in use. Each failed assertion
    has the ends of the logs as a note.
    """
    with (
        log.open("w") as output,
        subprocess.Popen(
            [*COMMAND, *arguments],
            stdout=output,
            stderr=output,
            stdin=subprocess.PIPE,
            text=True,
            env=environment,
        ) as process,
    ):

        def check() -> None:
            status = process.poll()
            assert not status or status < 0, f"{' '.join(arguments)}: ended with status {status}"

        process_checks.append(check)
        try:
            yield process
        except AssertionError as error:
            if not hasattr(error, "__notes__"):
                error.add_note(_ends_of_logs(log))
            raise
        finally:
            process_checks.remove(check)
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
                try:
                    process.wait(PATIENCE_S)
                except subprocess.TimeoutExpired:
                    process.kill()


def wait_for_text(text: str, log: Path, process: subprocess.Popen[str]) -> None:
    """Until the log of a process that ``running`` started has the text.

    AssertionError with the ends of all logs in its folder where the process ends without it, or is silent for too long.
    """

    def seen() -> bool:
        status = process.poll()  # before the log is read: what was written until the end is there
        found = text in log.read_text()
        assert found or status is None, f"ended with status {status} without {text!r} in {_ends_of_logs(log)}"
        return found

    wait_for(seen, lambda: f"{text!r} in {_ends_of_logs(log)}")


def _ends_of_logs(log: Path) -> str:
    folder = log.parent
    paths = sorted({log, *folder.rglob("*.log")})
    ends = [f"{path.relative_to(folder)}:\n{path.read_text()[-_END_OF_A_LOG:]}" for path in paths]
    return "the logs:\n" + "\n".join(ends)
