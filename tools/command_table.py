"""Which commands ``pdgw`` has, where each one is, and its line in the help: read without loading any of them.

A command's module is imported when the command is called, so that ``pdgw status`` pays for no simulator and ``pdgw --help`` for
nothing at all. A test holds the lines equal to what the commands themselves say.
"""

from __future__ import annotations

import gc
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup, TyperOption
from typer.main import get_command


def _refuse_repeats(command: Any, ctx: Any, args: list[str]) -> None:
    """An option with one value that is given twice is refused: typer takes the last."""
    seen: set[str] = set()
    for option in command.make_parser(ctx).parse_args(args)[2]:
        if not isinstance(option, TyperOption) or option.multiple or option.is_flag:
            continue
        if str(option.name) in seen and not ctx.resilient_parsing:
            raise typer.BadParameter("given more than once, takes one value", ctx, option)
        seen.add(str(option.name))


def _without_types_of_flags(options: list[Any]) -> list[Any]:
    """The help shows behind an option what is to be typed, behind a flag nothing: typer shows its type."""
    for option in options:
        if isinstance(option, TyperOption) and option.is_flag:
            option.metavar = ""
    return options


class _Careful:
    """Beside a class of typer: no value that was typed is dropped, and the help shows what is to be typed."""

    def get_params(self, ctx: Any) -> list[Any]:
        return _without_types_of_flags(super().get_params(ctx))  # type: ignore[misc]

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        given = list(args)
        rest: list[str] = super().parse_args(ctx, args)  # type: ignore[misc]
        _refuse_repeats(self, ctx, given)
        return rest


class Command(_Careful, TyperCommand):
    """A command of ``pdgw``."""


class Group(_Careful, TyperGroup):
    """A group of commands, of which some have options of their own."""


@dataclass(frozen=True, slots=True)
class Entry:
    """One line of the table: ``target`` is ``module:name`` in ``package``, a function or a group."""

    target: str
    help: str
    package: str = "pdgw.tools.commands"

    def load(self, name: str) -> Any:
        """Import the module and make the command."""
        module, _, attribute = self.target.partition(":")
        found = getattr(import_module(f"{self.package}.{module}"), attribute)
        gc.enable()
        holder = typer.Typer(add_completion=False)
        holder.callback()(lambda: None)  # makes it a group, also with a single command
        if isinstance(found, typer.Typer):
            for item in found.registered_commands:
                item.cls = Command
            own = found.info.cls
            holder.add_typer(found, name=name, cls=own if isinstance(own, type) else Group)
        else:
            holder.command(name, cls=Command)(found)
        group = get_command(holder)
        assert isinstance(group, TyperGroup)
        return group.commands[name]


COMMANDS: Mapping[str, Entry] = {
    "run": Entry(
        "run:run", "Run the gateway until SIGINT, SIGTERM or SIGQUIT; the drives are stopped and disabled first."
    ),
    "config": Entry("config:app", "Configuration files."),
    "bus": Entry("bus:app", "A CAN bus, before a gateway runs on it."),
    "axis": Entry("axis:app", "An axis that is brought into service."),
    "map": Entry(
        "map:map_",
        "Print the byte map of a configuration: offset, length, signal, unit and 100 % of every value; or code for the PLC.",
    ),
    "status": Entry(
        "status:status",
        "Show why axes are not in operation, and one line for each axis: pdgw status; everything about one: pdgw status 1.",
    ),
    "explain": Entry("explain:explain", "Show what happened around the last fault or stop, in at most ten lines."),
    "trace": Entry("trace:app", "The flight recorder: the last minutes of both buses."),
    "web": Entry(
        "web:web",
        "Show a running gateway to browsers, Prometheus and MQTT until SIGINT or SIGTERM; it changes nothing.",
    ),
    "param": Entry("param:app", "Parameters of a gateway or any PROFIdrive device."),
    "decode": Entry(
        "decode:decode", "Decode a piece of data (--hex), a capture of either bus, or what is on a bus now."
    ),
    "timeline": Entry(
        "timeline:timeline",
        "Merge captures of both buses: what the PLC asked, what became of it, how long it took, and why not.",
    ),
    "replay": Entry(
        "replay:replay",
        "Feed a recording through today's gateway; exit status 1 where it would have sent something else.",
    ),
    "eds": Entry("eds:app", "Data sheets (EDS, DCF)."),
    "drives": Entry("drives:app", "Families of drives."),
    "gsdml": Entry("gsdml:app", "The device description for engineering tools (GSDML)."),
    "sim": Entry("sim:app", "Simulators: PLC, drives, encoders, a bus of devices."),
    "demo": Entry(
        "demo:demo",
        "PLC, gateway and the bus of its drives as processes, chapter by chapter; every expectation with pass or fail.",
    ),
}
"""The commands of ``pdgw`` in the order of its help."""

SIM_COMMANDS: Mapping[str, Entry] = {
    "plc": Entry(
        "sim_plc:plc",
        "Play a scenario (exit status 1 when an expectation fails), obey the keyboard, or run a Structured Text program.",
    ),
    "drive": Entry(
        "sim_drive:drive",
        "Run simulated drives until SIGINT, SIGTERM or `quit`. Commands on standard input: see `pdgw sim inject`.",
    ),
    "encoder": Entry(
        "sim_encoder:encoder",
        "Run simulated encoders until SIGINT, SIGTERM or `quit`. Commands on standard input: see `pdgw sim inject`.",
    ),
    "bus": Entry(
        "sim_drive:bus",
        "Run the simulated devices of FILE with their faults until SIGINT, SIGTERM or `quit`; "
        "--serve opens the bus too.",
    ),
    "inject": Entry(
        "sim_drive:inject",
        "Give running simulated devices a command: `pdgw sim inject --port 5000 fault slow-sdo delay_ms=100`.",
    ),
}
"""The commands of ``pdgw sim``."""


def lazy_group(table: Mapping[str, Entry]) -> type[Group]:
    """The class of a command group (``typer.Typer(cls=...)``) whose commands are those of a table."""

    class LazyGroup(Group):
        """Lists stand-ins that know only their help; the command that is called is loaded."""

        def __init__(self, **attributes: Any) -> None:
            super().__init__(**attributes)
            for name, entry in table.items():
                self.add_command(TyperCommand(name, callback=None, help=entry.help))

        def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
            name, stand_in, rest = super().resolve_command(ctx, args)
            return name, (stand_in if name is None else table[name].load(name)), rest

    return LazyGroup
