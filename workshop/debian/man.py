"""Manual pages of ``pdgw``, one for each command, generated from the help."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from pdgw.tools.command_table import COMMANDS, EXAMPLES

_SECTION = 1


def pages(version: str) -> dict[str, str]:
    """The text of each page by file name: ``pdgw.1`` and ``pdgw-COMMAND.1``."""
    made = {"pdgw.1": _overview(version)}
    for name, entry in COMMANDS.items():
        lines = [*_head(f"pdgw-{name}", entry.help, version), *_command(f"pdgw {name}", entry.load(name), ".SH")]
        lines += [".SH SEE ALSO", f".BR pdgw ({_SECTION})"]
        made[f"pdgw-{name}.1"] = "\n".join(lines) + "\n"
    return made


def escaped(text: str) -> str:
    """Escape a line of text for roff, so that it contains no requests."""
    line = " ".join(text.split()).replace("\\", "\\e").replace("-", "\\-")
    return f"\\&{line}" if line[:1] in {".", "'"} else line


def _overview(version: str) -> str:
    lines = _head("pdgw", "PROFIdrive-to-CANopen gateway: daemon, simulators, decoder and tools.", version)
    lines += [".SH SYNOPSIS", ".B pdgw", "COMMAND [OPTIONS]...", ".SH COMMANDS"]
    for name, entry in COMMANDS.items():
        lines += [".TP", f".BR pdgw\\-{name} ({_SECTION})", escaped(entry.help)]
    lines += [".SH FILES"]
    for path, meaning in (
        ("/etc/pdgw/NAME.toml", "Configuration of the gateway NAME; the service is pdgw@NAME."),
        ("/var/lib/pdgw/NAME", "Its stored parameters."),
        ("/run/pdgw/NAME", "Its flight recorder."),
    ):
        lines += [".TP", f".I {escaped(path)}", escaped(meaning)]
    return "\n".join(lines) + "\n"


def _head(name: str, help_text: str, version: str) -> list[str]:
    title = f'.TH {escaped(name).upper()} {_SECTION} "" "profidrive\\-gateway {escaped(version)}" "User commands"'
    return [title, ".SH NAME", f"{escaped(name)} \\- {escaped(help_text)}"]


def _command(path: str, command: Any, heading: str) -> Iterator[str]:
    """Synopsis, options and example of a command, then of those below it."""
    yield f"{heading} {escaped(path) if heading == '.SS' else 'SYNOPSIS'}"
    if heading == ".SS":
        yield escaped(command.help or "")
        yield ".PP"
    shown = [item for item in command.params if not getattr(item, "hidden", False)]
    options = [item for item in shown if item.param_type_name == "option"]
    arguments = [item.metavar or str(item.name).upper() for item in shown if item not in options]
    words = [
        *arguments,
        *(["COMMAND"] if getattr(command, "commands", None) else []),
        *(["[OPTIONS]"] if options else []),
    ]
    yield f".B {escaped(path)}"
    yield escaped(" ".join(words)) or "\\&"
    if heading == ".SH":
        yield ".SH DESCRIPTION"
        for paragraph in (command.help or "").split("\n\n"):
            yield escaped(paragraph)
            yield ".PP"
        if options:
            yield ".SH OPTIONS"
    for option in options:
        yield ".TP"
        yield f".B {escaped(', '.join([*option.opts, *option.secondary_opts]))}"
        yield escaped(getattr(option, "help", None) or "") or "\\&"
    name = path.removeprefix("pdgw ")
    if name in EXAMPLES:
        yield ".PP"
        yield f"Example: {escaped(f'pdgw {EXAMPLES[name]}')}"
    below = getattr(command, "commands", {})
    if below:
        yield ".SH COMMANDS" if heading == ".SH" else ".PP"
    for part, item in below.items():
        yield from _command(f"{path} {part}", item, ".SS")
