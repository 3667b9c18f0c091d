"""Generate ``docs/commands.md``: every command with the first line of its help."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from pdgw.tools.command_table import COMMANDS
from tests.support.documents.parts import table

COMMANDS_PATH: Final = Path(__file__).parents[3] / "docs" / "commands.md"
_GUIDES: Final[Mapping[str, str]] = {
    "run": "operation.md",
    "bus": "commissioning.md",
    "device": "commissioning.md",
    "axis": "commissioning.md",
    "map": "plc.md",
    "status": "operation.md",
    "explain": "operation.md",
    "trace": "recordings.md",
    "web": "web.md",
    "param": "parameter-channel.md",
    "decode": "recordings.md",
    "timeline": "recordings.md",
    "replay": "recordings.md",
    "drives": "devices.md",
    "sim": "simulation.md",
    "demo": "simulation.md",
}
"""The document of a command or of its group."""
_INTRODUCTION: Final = """\
# Commands

For users of a terminal. Generated from the commands by `make docs`; do not edit.

`pdgw COMMAND --help` (or `-h`) describes the options of a command. `pdgw --install-completion` adds completion to
your shell. Examples:

    pdgw --version
    pdgw config example > gateway.toml      # a commented configuration
    pdgw param read P922 6041h 0x1018.3
    pdgw decode plc.pcap --filter 'stw1.on == 0 and axis == 1'
    pdgw timeline plc.pcap can.log
    pdgw replay recording/gateway.pcapng

`pdgw run --web` also starts the [page](web.md), `pdgw run --record FOLDER` a recording of both buses.

"""
_EXIT_CODES: Final = (
    ("0", "done; every expectation, check or comparison passed"),
    (
        "1",
        "a failed expectation, check, comparison or parameter, a damaged capture, a difference of `pdgw replay`, a file that "
        "`pdgw config check` or `pdgw drives` rejects; or an error, reported in one line",
    ),
    ("2", "the command line is wrong: an unknown option, a number out of range"),
    (
        "130",
        "interrupted (Ctrl-C, SIGTERM; `pdgw sim plc` and `pdgw demo` also by the end of the terminal); recordings are "
        "complete. `pdgw run` ends with 0",
    ),
)
_LONG: Final = """\

`pdgw status --check` has its own codes ([monitoring](operation.md#monitoring)).
"""


def _commands(command: Any, name: str) -> Iterator[tuple[str, str]]:
    """Each command with the first line of its help. A group yields its commands."""
    below = getattr(command, "commands", {})
    if not below:
        yield name, (command.help or "").strip().partition("\n")[0]
    for word, item in below.items():
        yield from _commands(item, f"{name} {word}")


def _guide(name: str) -> str:
    document = _GUIDES.get(name) or _GUIDES.get(name.partition(" ")[0], "")
    return f"[{document}]({document})" if document else ""


def generate_commands() -> str:
    """Generate the document."""
    commands = (found for name, entry in COMMANDS.items() for found in _commands(entry.load(name), name))
    rows = ((f"`pdgw {name}`", text, _guide(name)) for name, text in commands)
    commands_table = table(("command", "purpose", "document"), rows)
    return f"{_INTRODUCTION}{commands_table}\n## Exit codes\n\n{table(('exit code', 'means'), _EXIT_CODES)}{_LONG}"


if __name__ == "__main__":
    COMMANDS_PATH.write_text(generate_commands(), encoding="utf-8")
