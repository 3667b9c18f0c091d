"""What runs on Windows and macOS too: nothing of it may need modules and calls that only Linux or POSIX has.

The commands run in processes in which these are missing. That Windows behaves otherwise in other things is not shown here.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.service.status_client import fetch
from tests.support.axis.recorded import speed
from tests.support.axis.rig import NODE
from tests.support.buses import PATIENCE_S, wait_for
from tests.support.processes import PATIENT, free_tcp_port, free_udp_port, running

_ELSEWHERE = """
import asyncio, ctypes, logging, mmap, multiprocessing, os, pathlib, select, selectors, signal, socket, subprocess, sys, tempfile
import time
class Missing:
    names = {"termios", "tty", "pty", "fcntl", "pwd", "grp", "resource", "syslog", "readline", "curses"}
    def find_spec(self, name, *_):
        if name in self.names:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Missing())
for name in Missing.names:
    sys.modules.pop(name, None)
for module, names in (
    (select, ("poll", "epoll", "kqueue")),
    (selectors, ("PollSelector", "EpollSelector", "KqueueSelector")),
    (socket, ("AF_UNIX", "AF_PACKET", "AF_CAN", "AF_NETLINK", "CAN_RAW", "SO_REUSEPORT", "SO_BINDTODEVICE", "MSG_DONTWAIT")),
    (os, ("sched_setscheduler", "sched_setaffinity", "sched_param", "fork", "getuid", "geteuid", "mkfifo", "nice")),
    (os, ("killpg", "setsid", "sysconf", "statvfs", "getloadavg", "chown", "fchmod", "O_DIRECTORY", "O_CLOEXEC", "O_NOFOLLOW")),
    (signal, ("SIGHUP", "SIGKILL", "SIGUSR1", "SIGUSR2", "SIGQUIT", "SIGALRM", "setitimer", "pthread_sigmask")),
    (time, ("clock_gettime", "clock_gettime_ns", "CLOCK_MONOTONIC", "CLOCK_PROCESS_CPUTIME_ID", "CLOCK_THREAD_CPUTIME_ID")),
    (mmap, ("MAP_SHARED", "MAP_PRIVATE", "MAP_POPULATE", "PROT_READ", "PROT_WRITE")),
):
    for name in names:
        if hasattr(module, name):
            delattr(module, name)
selectors.DefaultSelector = selectors.SelectSelector
def socketpair(*_):
    with socket.create_server(("127.0.0.1", 0)) as server:
        first = socket.create_connection(server.getsockname())
        return first, server.accept()[0]
socket.socketpair = socketpair
open_file = os.open
def no_folder(path, *arguments, **options):
    if os.path.isdir(path) and sys._getframe(1).f_globals["__name__"] != "shutil":
        raise PermissionError(13, "Permission denied", str(path))
    return open_file(path, *arguments, **options)
os.open = no_folder
"""
_RUN = """
from pdgw.__main__ import run
sys.argv[0] = "pdgw"
run()
"""
_RUN_EACH = """
from pdgw.__main__ import run
from tests.long.soak.__main__ import main as soak
for line in sys.stdin:
    sys.argv = ["pdgw", *line.rstrip("\\n").split("\\t")]
    print("\\0", end="")
    sys.stderr.write("\\0")
    status = 0
    try:
        if sys.argv[1] == "soak":
            del sys.argv[1]
            status = soak()
        else:
            run()
    except SystemExit as end:
        status = end.code or 0
    print(f"\\1{status}", end="")
"""
"""Commands with tabs between their words, line by line; what each prints, then its exit status."""
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="the real thing")


def elsewhere(*arguments: str, text: str = "") -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", _ELSEWHERE + _RUN, *arguments]
    return subprocess.run(command, input=text, capture_output=True, text=True, timeout=PATIENCE_S, check=False)


def each_elsewhere(*commands: tuple[str, ...]) -> Iterator[tuple[int, str, str]]:
    """Exit status, standard output and standard error of commands, one after the other in one such process."""
    lines = "".join("\t".join(command) + "\n" for command in commands)
    command = [sys.executable, "-c", _ELSEWHERE + _RUN_EACH]
    done = subprocess.run(command, input=lines, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    outputs, errors = done.stdout.split("\0")[1:], done.stderr.split("\0")[1:]
    assert done.returncode == 0, done.stderr
    assert len(outputs) == len(errors) == len(commands)
    for output, error in zip(outputs, errors, strict=True):
        printed, _, status = output.rpartition("\1")
        yield int(status), printed, error


@pytest.fixture
def recording(tmp_path: Path) -> list[str]:
    return speed().frames.write(tmp_path)


@pytest.fixture
def configuration(tmp_path: Path) -> str:
    path = tmp_path / "gateway.toml"
    path.write_text(
        '[can]\ninterface = "virtual"\n[transport]\ncycle_time_ms = 4\n[[axis]]\ndo_id = 1\n'
        f"node_id = {NODE}\ntelegram = 1\n"
    )
    return str(path)


@pytest.mark.e2e
def test_files_are_decoded_and_unsupported_functions_are_reported(
    recording: list[str], configuration: str, tmp_path: Path
) -> None:
    plc, can = recording
    commands = (
        ("--version",),
        ("config", "example"),
        ("config", "check", configuration),
        ("map", configuration, "--format", "scl"),
        ("decode", "--hex", "047F 2000", "--telegram", "1"),
        ("decode", plc, "--stats"),
        ("decode", can, "--config", configuration, "--json"),
        ("timeline", plc, can, "--config", configuration, "--html", str(tmp_path / "t.html")),
        ("drives", str(next(Path(__file__).parents[2].glob("dsp406/eds/*.eds")))),
        ("sim", "bus", "--example"),
        ("map", "--gsdml", str(tmp_path)),
        ("drives", "epos4"),
        ("soak", "--hours", "0.001"),
        ("trace", "list"),
    )
    profinet = tmp_path / "profinet.toml"
    profinet.write_text(
        '[can]\ninterface = "virtual"\n[transport]\ntype = "profinet"\ninterface = "lo"\n'
        "[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = 1\n"
    )
    *done, raw, live = each_elsewhere(*commands, ("run", str(profinet)), ("decode", "--live", "eth0"))
    for command, (status, _, error) in zip(commands, done, strict=True):
        assert status == 0, (command, error[-600:])
    assert raw[0] == live[0] == 1
    assert 'raw Ethernet needs Linux; use type = "udp" on other systems' in raw[2]
    assert "live captures need Linux; record with dumpcap and decode the file" in live[2]


@contextmanager
def gateway(store: Path) -> Iterator[tuple[int, int, int]]:
    """A gateway with a simulated drive in such a process: its ports for frames, parameters, status."""
    ports = free_udp_port(), free_udp_port(), free_tcp_port()
    names = ("--cyclic-port", "--acyclic-port", "--status-port")
    options = [part for name, port in zip(names, ports, strict=True) for part in (name, str(port))]
    config = store.with_suffix(".toml")
    config.write_text(
        f'store = "{store.name}"\n[can]\ninterface = "virtual"\n[transport]\ncycle_time_ms = 20\nwatchdog_factor = 250\n'
        "[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = 1\nsimulate = true\n" + PATIENT
    )
    # The simulated devices are a process that this one starts: nothing is there in it either.
    (store.parent / "sitecustomize.py").write_text(_ELSEWHERE)
    log = store.with_suffix(".log")
    with running("run", str(config), *options, log=log, environment=os.environ | {"PYTHONPATH": str(store.parent)}):
        yield ports
    assert "Traceback" not in log.read_text(), log.read_text()


def drive_on(status: int) -> str:
    """What the gateway says of its drive; nothing while it does not answer."""
    try:
        return str(fetch(status, PATIENCE_S)["axes"][0]["drive"])
    except GatewayError:
        return ""


@pytest.mark.e2e
def test_gateway_runs_answers_and_follows_the_keyboard(tmp_path: Path) -> None:
    store = tmp_path / "store.json"
    with gateway(store) as (cyclic, acyclic, status):
        wait_for(lambda: drive_on(status) == "online", "the drive is online")
        parameters = "--gateway", f"127.0.0.1:{acyclic}"
        done = list(
            each_elsewhere(
                ("status", "--port", str(status), "--json"),
                ("param", "read", "P922", "--json", *parameters),
                ("param", "write", "P925", "7", *parameters),
                ("param", "dump", str(tmp_path / "axis.json"), *parameters),
            )
        )
        assert [command[0] for command in done] == [0] * 4, done
        assert json.loads(done[0][1])["axes"][0]["drive"] == "online"
        assert json.loads(done[1][1])[0]["value"] == 1
        plc = elsewhere("sim", "plc", "--interactive", "--gateway", f"127.0.0.1:{cyclic}", text="ex")
        assert plc.returncode == 0, plc.stderr
        assert "enable" in plc.stderr
    assert store.exists()
