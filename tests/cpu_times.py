"""``python -m pytest -p tests.cpu_times``: CPU time of the tests and of the processes they start, by folder, and the slowest.

Time that a test waits is not in it. A fixture of a module counts for the test that needs it first. ``tests.room_tests`` shows
the sums of the files of the last runs.
"""

from __future__ import annotations

import resource
import time
from collections import defaultdict
from collections.abc import Generator, Iterator, Mapping

import pytest

SLOWEST = 40
CACHE = "pdgw/cpu_times"
"""Key of pytest's cache for the seconds of each file."""
_PROPERTY = "CPU in s"
_begun = 0.0
_seconds: dict[str, float] = {}
"""Of each test that has ended, by its name; with pytest-xdist those of all workers."""


def _spent() -> float:
    """Seconds that this process has computed, and those of its children that have ended."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    global _begun  # noqa: PLW0603 (a hook has no other place)
    _begun = _spent()


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_teardown(item: pytest.Item) -> Generator[None, None, None]:
    """What a worker measured goes with its report to the process that prints it."""
    yield
    item.user_properties.append((_PROPERTY, _spent() - _begun))


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if report.when == "teardown":
        _seconds[report.nodeid] = float(str(dict(report.user_properties)[_PROPERTY]))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    terminalreporter.section("CPU time")
    for line in lines(_seconds):
        terminalreporter.write_line(line)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Keep the seconds of the files, those of all workers together."""
    if _seconds and session.config.cache is not None and not hasattr(session.config, "workerinput"):
        files: dict[str, float] = defaultdict(float)
        for name, spent in _seconds.items():
            files[name.partition("::")[0]] += spent
        session.config.cache.set(CACHE, session.config.cache.get(CACHE, {}) | files)


def lines(seconds: Mapping[str, float]) -> Iterator[str]:
    """The sum, then each folder with its number of tests, then the slowest tests; the longest first."""
    folders: dict[str, list[float]] = defaultdict(list)
    for name, spent in seconds.items():
        folders[name.partition("::")[0].rpartition("/")[0]].append(spent)
    yield f"{sum(seconds.values()):8.2f} s {len(seconds):5} tests"
    for folder, of_tests in sorted(folders.items(), key=lambda item: -sum(item[1])):
        yield f"{sum(of_tests):8.2f} s {len(of_tests):5} tests in {folder}"
    for name, spent in sorted(seconds.items(), key=lambda item: -item[1])[:SLOWEST]:
        yield f"{spent:8.2f} s {name}"
