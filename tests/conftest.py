"""Hypothesis profiles: ``ci`` is deterministic; ``fuzz`` (make fuzz) searches long with fresh seeds.

No test uses the user's state or run directory. A test that starts a Python, a gateway, a broker or a network namespace, or needs
time to pass on the wall clock, is marked ``e2e``; one with Chromium ``browser``. ``tests/test_marks.py`` holds their number.
"""

from __future__ import annotations

import errno
import gc
import os
import signal
import subprocess
import sys
from collections.abc import Generator, Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from pdgw.gateway.base.identity import COMPILED, kind
from pdgw.tools.recording import recorder
from tests.support.buses import PATIENCE_S
from tests.support.logs import log_put_back

settings.register_profile(
    "ci", derandomize=True, deadline=None, max_examples=40, database=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.register_profile("fuzz", deadline=None, max_examples=20_000, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile(os.environ.get("PDGW_HYPOTHESIS", "ci"))


# Compiled tests and sources are kept for the next run: to compile the tests takes each worker 11 s.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# Of a suite that a shell started in the background SIGINT is ignored, and with it of every process that a test interrupts.
signal.signal(signal.SIGINT, signal.default_int_handler)

if hasattr(os, "sched_setscheduler"):
    _set_scheduler = os.sched_setscheduler

    def _of_others(pid: int, policy: int, parameters: os.sched_param) -> None:
        if pid in {0, os.getpid()}:
            raise PermissionError(errno.EPERM, "the scheduling of the tests' process stays as it is")
        _set_scheduler(pid, policy, parameters)

    # A gateway asks for real-time priority when it starts; one that a test runs in this process does not get it.
    os.sched_setscheduler = _of_others

# Tables and messages of commands are folded to this width, whatever the terminal of those who run the tests.
os.environ["COLUMNS"] = "80"

# What collecting the tests makes stays until the end: the collector walks it neither while it grows nor later.
gc.disable()


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()
    # A gateway that runs in this process freezes what there is and at its end unfreezes all, also what was collected.
    gc.freeze = gc.unfreeze = lambda: None


_marked = True
"""The test that runs now may start processes."""


def needs_the_mark(what: str) -> None:
    """Raises AssertionError when the test that starts this is not marked."""
    if not _marked:
        raise AssertionError(f"this test starts {what} and is not marked e2e")


def _on_audit(event: str, arguments: tuple[object, ...]) -> None:
    """Record real processes. Programs that only read a file (tshark, node, git ...) do not count: timing does not affect them."""
    if event == "subprocess.Popen":
        program = Path(str(arguments[0])).name
        if program.startswith(("python", "pdgw", "unshare", "mosquitto")):
            needs_the_mark(program)


sys.addaudithook(_on_audit)


def is_real(item: pytest.Item) -> bool:
    """Whether a test may start processes and has the wall clock."""
    return item.get_closest_marker("e2e") is not None or item.get_closest_marker("browser") is not None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What waits for processes comes first: one worker has it all, one after the other, and short tests are left for the end."""
    items.sort(key=lambda item: not is_real(item))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, bool, bool]:
    """From the set-up of the fixtures, also of a module's, until they are gone."""
    global _marked  # noqa: PLW0603 (an audit hook cannot be removed and has no argument for it)
    _marked = is_real(item)
    try:
        return (yield)
    finally:
        _marked = True


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Run a test that plants a defect in a process with the sources: a compiled class cannot be changed."""
    if pyfuncitem.get_closest_marker("planted") is None or kind() != COMPILED:
        return None
    global _marked  # noqa: PLW0603
    _marked = True
    environment = {name: value for name, value in os.environ.items() if name not in {"PYTHONPATH", "PYTHONSAFEPATH"}}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", pyfuncitem.nodeid]
    done = subprocess.run(
        command, cwd=pyfuncitem.config.rootpath, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout
    return True


@pytest.fixture(scope="session", autouse=True)
def _state_directory(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Parameter stores of configurations that name none, and rings, also of the processes that tests start."""
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("STATE_DIRECTORY", raising=False)
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        patch.delenv("RUNTIME_DIRECTORY", raising=False)
        patch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("run")))
        yield


@pytest.fixture(autouse=True)
def _log() -> Iterator[None]:
    """What a command sets up in a test's own process would change what the next test hears."""
    with log_put_back():
        yield


@pytest.fixture(scope="session", autouse=True)
def _patience() -> Iterator[None]:
    """A log or a recording that was stopped is whole, also where its thread got no processor for seconds."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recorder, "END_S", PATIENCE_S)
        yield
