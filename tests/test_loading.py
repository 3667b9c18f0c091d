"""Modules loaded by the package, by commands and by rules: only those that they need.

Each script is a Python process of its own, because modules stay loaded.
"""

from __future__ import annotations

import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

from pdgw.gateway import axis, motion
from pdgw.tools.command_table import COMMANDS, EXAMPLES
from tests.support.readers.both_buses import write_capture

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


# What a command works with, and no help needs: libraries, then packages and modules of the product.
_HEAVY = {
    *(
        "asyncio",
        "can",
        "canopen",
        "duckdb",
        "greenlet",
        "hypothesis",
        "matplotlib",
        "multiprocessing",
        "pyarrow",
        "scapy",
    ),
    *("starlette", "uvicorn", "xml.etree.ElementTree", "yaml"),
}
_NOT_FOR_HELP = {*_HEAVY, "importlib.metadata", "pydantic"}
"""What starting to work loads, such as the conversion of an option, and printing the help does not."""
_OF_COMMANDS = (
    *(
        "pdgw.tools.decoder",
        "pdgw.dsp402.drive",
        "pdgw.gateway.axis",
        "pdgw.gateway.configuration.config",
        "pdgw.gateway.configuration.devices",
        "pdgw.gateway.daemon.daemon",
    ),
    *(
        "pdgw.gateway.base.udp",
        "pdgw.gateway.motion",
        "pdgw.gateway.base.fault_numbers",
        "pdgw.gateway.base.reasons",
        "pdgw.peers",
        "pdgw.profinet.device",
        "pdgw.tools.web",
        "tests.long",
    ),
)
_WORDS_OF_HELP = {"pdgw.peers", "pdgw.peers.option_values"}


def help_of_all() -> list[str]:
    """The call for the help of each command, also of those below a group.

    ``param`` has options before its commands. They are converted before the help of a command is printed.
    """
    below = [name for name in EXAMPLES if " " in name and not name.startswith("param ")]
    return [f"{name} -h" for name in (*COMMANDS, *below)]


@pytest.mark.e2e
def test_package_and_commands_import_only_what_they_need(tmp_path: Path) -> None:
    # The package itself, then the help of every command, then commands that only read, then those that decode.
    capture = tmp_path / "both.pcapng"
    write_capture(capture, 40)
    door, helping, reading, looking, saving, decoding, following = loaded(
        ", ".join(["--help, -h", *help_of_all()]),
        "status 1, status --port 1, explain 1, trace list",
        "--version",
        f"trace save {tmp_path / 'saved.pcapng'} --ring none",
        "decode --hex 047F2000 --telegram 1",
        f"timeline {capture} --telegram 1",
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
    assert {"pdgw.tools.commands.capture.decode", "pdgw.tools.commands.simulation.plc"} <= helping
    assert helping & _NOT_FOR_HELP == set()
    assert reading & _NOT_FOR_HELP == set()
    assert looking & _HEAVY == set()
    assert "pydantic" not in saving, "a text, a path and a number need it not"
    for modules in (helping, reading, looking):
        products = {name for name in modules if any(name == top or name.startswith(f"{top}.") for top in _OF_COMMANDS)}
        assert products <= _WORDS_OF_HELP
    assert not decoding & {"scapy", "matplotlib", "can", "canopen", "pdgw.gateway.daemon.daemon", "pdgw.peers.drive"}
    assert "pdgw.tools.decoder.timeline.builder" in following
    replaying = {"pdgw.tools.decoder.step_replay", "pdgw.gateway.axis.machine", "pdgw.gateway.configuration.config"}
    assert not following & {"can", "canopen", "greenlet", *replaying}
    # A configuration needs no bus.
    (configuring,) = python("import sys, pdgw.gateway.configuration.file; print(*sys.modules)")
    assert not configuring & {"can", "canopen", "greenlet"}
    # The daemon loads no tools.decoder and only the transport it has.
    (daemon,) = python("import sys, pdgw.gateway.daemon.assembly; print(*sys.modules)")
    assert "pdgw.gateway.daemon.daemon" in daemon
    other = {"pdgw.tools.decoder.frames.engine", "pdgw.gateway.links.profinet.io_device", "pdgw.profinet.device"}
    assert not daemon & ({"scapy", "matplotlib"} | other)
    # Axis machine and motion are there where no bus, socket, clock, thread or log exists.
    python(f"import sys; sys.modules.update(dict.fromkeys({_IMPURE!r})); import {', '.join(_PURE)}")
