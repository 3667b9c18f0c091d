"""What is loaded for what: a door, a command and the rules bring along only what they work with.

Each script is a Python of its own, because what was once loaded stays.
"""

from __future__ import annotations

import pkgutil
import subprocess
import sys

import pytest

from pdgw.gateway import axis, motion

_IMPURE = (
    "can",
    "canopen",
    "threading",
    "time",
    "socket",
    "selectors",
    "logging",
    "asyncio",
    "queue",
    "subprocess",
    "scapy",
)
_PURE = [
    module.name
    for package in (axis, motion)
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + ".")
]
_COMMANDS = """
import contextlib, io, sys
import pdgw
pdgw.signal("STW1")
print(*sys.modules)
from pdgw.tools.cli import main
for command in sys.argv[1:]:
    for part in command.split(", "):
        sys.argv = ["pdgw", *part.split()]
        with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
            main()
    print(*sys.modules)
"""


def python(code: str, *arguments: str) -> list[set[str]]:
    """The words in each line that a Python of its own prints."""
    done = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return [set(line.split()) for line in done.stdout.splitlines()]


def loaded(*commands: str) -> list[set[str]]:
    """The modules there are after a signal was looked up, then after each of these commands (several: with a comma between)."""
    return python(_COMMANDS, *commands)


@pytest.mark.e2e
def test_a_door_a_command_and_the_rules_load_only_what_they_work_with() -> None:
    # The front door, then commands that only look, then those that read files and ask for parameters.
    door, looking, reading = loaded(
        "--help, -h, sim -h, --version, status --port 1", "decode --hex 047F2000 --telegram 1, param -h"
    )
    assert "pdgw.profidrive.signals" in door
    assert not door & {
        "can",
        "canopen",
        "scapy",
        "pydantic",
        "typer",
        "pdgw.gateway.configuration.config",
        "importlib.metadata",
    }
    assert not looking & {
        "scapy",
        "matplotlib",
        "can",
        "canopen",
        "yaml",
        "pyarrow",
        "pdgw.gateway.configuration.config",
    }
    assert not {name for name in looking if name.startswith("pdgw.peers")}
    assert not reading & {"scapy", "matplotlib", "can", "canopen", "pdgw.gateway.daemon", "pdgw.peers.drive"}
    # The daemon loads no decoder and only the transport it has.
    _, daemon = loaded("run -h")
    other = {"pdgw.decoder.frames.engine", "pdgw.gateway.links.profinet.link", "pdgw.profinet.device"}
    assert not daemon & ({"scapy", "matplotlib"} | other)
    # Axis machine and motion are there where no bus, socket, clock, thread or log exists.
    python(f"import sys; sys.modules.update(dict.fromkeys({_IMPURE!r})); import {', '.join(_PURE)}")
