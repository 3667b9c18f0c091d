"""The command line as a whole: what its help says, and that a command loads only what it uses."""

from __future__ import annotations

import shlex
import subprocess
import sys
import sysconfig
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
from rich.text import Text
from typer.core import TyperOption
from typer.testing import CliRunner, Result

from pdgw.base.phrases import counted
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.configuration.file import load_config
from pdgw.gateway.links import cyclic
from pdgw.tools import commands
from pdgw.tools.cli import app
from pdgw.tools.command_table import COMMANDS, EXAMPLES, GROUPS, Command, Entry, Group
from pdgw.tools.commands.gateway.run import _with_options

ENTRIES = [*COMMANDS.items(), *(item for table in GROUPS.values() for item in table.items())]
_HELPERS = {"__init__", "options"}


@pytest.mark.parametrize(("name", "entry"), ENTRIES, ids=[name for name, _ in ENTRIES])
def test_command_table_has_the_help_line_of_each_command(name: str, entry: Entry) -> None:
    command = entry.load(name)
    own = (command.help or "").split("\n\n")[0]
    assert entry.help == " ".join(own.split())


def commands_of(name: str, command: Any) -> Iterator[tuple[str, Any]]:
    """A command and all below it."""
    yield name, command
    for below, item in getattr(command, "commands", {}).items():
        if command.get_command(None, below).params:  # not a placeholder
            yield from commands_of(f"{name} {below}", item)


EVERY = [
    item
    for group, table in (("", COMMANDS), *((f"{group} ", table) for group, table in GROUPS.items()))
    for name, entry in table.items()
    for item in commands_of(group + name, entry.load(name))
]


def invoke(name: str, *arguments: str) -> Result:
    """Call a command by its name in ``EVERY``."""
    return CliRunner().invoke(app, [*name.split(), *arguments])


@pytest.mark.parametrize(("name", "command"), EVERY, ids=[name for name, _ in EVERY])
def test_repeated_option_with_one_value_is_rejected(name: str, command: Any) -> None:
    assert isinstance(command, Command | Group), "what looks at it"
    options = [item for item in command.params if isinstance(item, TyperOption)]
    for option in options:
        if option.multiple or option.is_flag:
            continue
        choices = option.type_descriptor.choices
        value = choices[0].value if choices else str(1 if option.min is None else option.min)
        value = value.zfill(32) if "uuid" in str(option.name) else value
        others = [
            a for item in command.params if not isinstance(item, TyperOption) for a in ["1"] * bool(item.required)
        ]
        result = invoke(name, *others, option.opts[0], value, option.opts[0], value)
        assert result.exit_code == 2, (option.opts, result.output)
        assert "given more than once" in " ".join(result.output.replace("│", " ").split()), (option.opts, result.output)


REPORTS = [
    (name, option.opts[0])
    for name, command in EVERY
    for option in command.params
    if option.opts[0] in {"--html", "--junit", "--pcap"}
]


@pytest.mark.parametrize(("name", "option"), REPORTS)
@pytest.mark.parametrize(("place", "why"), [(".", "Is a directory"), ("nowhere/x.out", "No such file or directory")])
def test_unwritable_file_is_reported_before_the_work(
    name: str, option: str, place: str, why: str, tmp_path: Path
) -> None:
    arguments = ["x"] * (name in {"decode", "timeline"})
    result = invoke(name, *arguments, option, str(tmp_path / place))
    assert isinstance(result.exception, GatewayError), result.output
    assert str(result.exception) == f"{option} {tmp_path / place}: cannot be written ({why})"


@pytest.mark.parametrize("name", ["", *(name for name, _ in EVERY)])
def test_the_help_shows_what_is_to_be_typed(name: str) -> None:
    output = invoke(name, "--help").output
    assert "Usage: " in output
    assert "<bool>" not in output


@pytest.mark.parametrize(("name", "command"), EVERY, ids=[name for name, _ in EVERY])
def test_no_bracket_of_a_help_text_counts_as_markup(name: str, command: Any) -> None:
    texts = [command.help or "", *(getattr(item, "help", None) or "" for item in command.params)]
    assert [text for text in texts if Text.from_markup(text).plain != text] == []


PRODUCT = [(name, command) for name, command in EVERY if isinstance(command, Command)]


def test_there_are_at_most_31_commands() -> None:
    assert len(PRODUCT) <= 31


@pytest.mark.parametrize(("name", "command"), PRODUCT, ids=[name for name, _ in PRODUCT])
def test_the_help_of_a_command_ends_with_an_example_that_it_accepts(name: str, command: Any) -> None:
    example = EXAMPLES[name]
    assert f"Example: pdgw {example}" in " ".join(invoke(name, "--help").output.split())
    words = shlex.split(example.partition(" >")[0])
    assert words[: len(name.split())] == name.split()
    command.make_context(name, words[len(name.split()) :], resilient_parsing=False)


def test_every_module_of_a_command_is_in_the_table() -> None:
    folder = Path(commands.__path__[0])
    modules = {
        ".".join(path.relative_to(folder).with_suffix("").parts)
        for path in folder.rglob("*.py")
        if path.stem not in _HELPERS
    }
    assert modules == {entry.target.partition(":")[0] for _, entry in ENTRIES}


def test_version_is_that_of_the_installed_package_and_names_the_build() -> None:
    result = CliRunner().invoke(app, ["--version"])
    optimised = ", PGO" if "--enable-optimizations" in sysconfig.get_config_var("CONFIG_ARGS") else ""
    build = "compiled" if cyclic.__file__.endswith(".so") else "pure Python"
    expected = (
        f"{version('profidrive-gateway')}, {build}, CPython {'.'.join(map(str, sys.version_info[:3]))}{optimised}"
    )
    assert (result.exit_code, result.output) == (0, f"pdgw {expected}\n")


@pytest.mark.parametrize("arguments", [["-h"], ["status", "-h"], ["sim", "inject", "-h"], ["param", "read", "-h"]])
def test_h_is_help_everywhere(arguments: list[str]) -> None:
    short = CliRunner().invoke(app, arguments)
    long = CliRunner().invoke(app, [*arguments[:-1], "--help"])
    assert (short.exit_code, short.output) == (0, long.output)
    assert "Usage: " in short.output


def test_unknown_command_is_reported_with_a_suggestion() -> None:
    result = CliRunner().invoke(app, ["statsu"])
    assert result.exit_code == 2
    assert "Did you mean 'status'?" in result.output


_INTERRUPTED = """
import os, sys
module, way = sys.argv[1:]
class Finder:
    def find_spec(self, name, *_):
        if name == module and way == "signal":
            os.kill(os.getpid(), 2)
        elif name == module:
            raise KeyboardInterrupt
sys.modules.pop("signal", None)
sys.meta_path.insert(0, Finder())
sys.argv = ["pdgw", "status", "--port", "1"]
from pdgw.__main__ import run
run()
"""


def test_an_option_of_run_changes_its_key_alone(tmp_path: Path) -> None:
    path = tmp_path / "gateway.toml"
    path.write_text('[can]\ninterface = "virtual"\n[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = 1\n')
    config = load_config(path)
    changed = _with_options(config, {"cycle_time_ms": 8, "peer": None})
    assert changed.transport.cycle_time_ms == 8
    assert changed.model_copy(update={"transport": config.transport}) == config


@pytest.mark.e2e
@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_ctrl_c_while_the_command_loads_prints_nothing() -> None:
    cases = [
        ("signal", "exception"),
        ("typer", "exception"),
        ("typer", "signal"),
        ("pdgw.gateway.service.status_client", "signal"),
    ]
    for case in cases:
        script = [sys.executable, "-c", _INTERRUPTED, *case]
        done = subprocess.run(script, capture_output=True, text=True, check=False)
        assert (case, done.returncode, done.stdout, done.stderr) == (case, 130, "", "")


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["sim", "drive", "--control-port", "99999"], "'99999': allowed: at most 65535"),
        (["sim", "encoder", "--control-port", "-1"], "'-1': allowed: at least 0"),
        (["sim", "inject", "--port", "99999", "clear"], "'99999': allowed: at most 65535"),
        (["status", "--port", "99999"], "'99999': allowed: at most 65535"),
    ],
)
def test_invalid_port_is_reported(arguments: list[str], told: str) -> None:
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 2
    assert told in " ".join(result.output.replace("│", " ").split())


@pytest.mark.parametrize(
    ("words", "found"), [("pdgw stat", "status"), ("pdgw sim pl", "plc"), ("pdgw decode --tele", "--telegram")]
)
def test_the_shell_completes_commands_and_options(words: str, found: str) -> None:
    asked = {"COMP_WORDS": words, "COMP_CWORD": str(len(words.split()) - 1), "_PDGW_COMPLETE": "complete_bash"}
    assert CliRunner().invoke(app, [], env=asked, prog_name="pdgw").output.split() == [found]


@pytest.mark.parametrize(("number", "text"), [(0, "0 axes"), (1, "1 axis"), (2, "2 axes")])
def test_a_number_and_its_noun_agree(number: int, text: str) -> None:
    assert counted(number, "axis", "axes") == text
    assert counted(number, "row") == f"{number} row{'' if number == 1 else 's'}"
