"""The commands of ``pdgw``, with module and help line. Reading the table imports none of the commands.

A command's module is imported when the command is called, so that ``pdgw status`` and ``pdgw --help`` start fast. A test
compares the help lines with those of the commands.
"""

from __future__ import annotations

import gc
import re
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup, TyperOption
from typer.main import get_command


def _refuse_repeats(command: Any, ctx: Any, args: list[str]) -> None:
    """Reject an option that is given twice but has one value; typer would use the last value without a message."""
    seen: set[str] = set()
    for option in command.make_parser(ctx).parse_args(args)[2]:
        if not isinstance(option, TyperOption) or option.multiple or option.is_flag:
            continue
        if str(option.name) in seen and not ctx.resilient_parsing:
            raise typer.BadParameter("given more than once, allowed once", ctx, option)
        seen.add(str(option.name))


_NUMBER = re.compile(r"-?[0-9]{1,10}")


def _convert_texts_only(option: Any) -> None:
    """Leave a default as it is, and convert a plain number, a text and a path: typer loads pydantic for any value, also None."""
    convert = option.process_value
    kind, limits = option.type_descriptor.annotation, option.type_descriptor.parameter_info
    is_one = option.nargs == 1 and option.callback is None

    def process(ctx: Any, value: Any) -> Any:
        if is_one and kind in (str, Path) and isinstance(value, str):
            return kind(value)
        if is_one and kind is int and _NUMBER.fullmatch(str(value)):
            number = int(value)
            if (limits.min is None or number >= limits.min) and (limits.max is None or number <= limits.max):
                return number
        several = option.multiple or option.nargs != 1
        if several or option.required or option.callback is not None or isinstance(value, str):
            return convert(ctx, value)
        return value

    option.process_value = process


def _plain_flags(options: list[Any]) -> list[Any]:
    """Remove the type that typer prints after a flag in the help, and make a flag that is not given False.

    Typer's own flags (``--help``) are None by default.
    """
    for option in options:
        if "process_value" not in vars(option):
            _convert_texts_only(option)
        if isinstance(option, TyperOption) and option.is_flag:
            option.metavar = ""
            option.default = option.default or False
    return options


def _in_words(error: typer.BadParameter) -> str:
    """The message of a wrong value, also where typer has the words of pydantic."""
    cause: Any = error.__cause__
    if not hasattr(cause, "error_count"):
        return error.message
    from pdgw.base.validation import value_text  # noqa: PLC0415 (loads pydantic, as typer has done)

    several = "; repeat the option for several" if error.param is not None and error.param.multiple else ""
    return value_text(cause) + several


class _Careful:
    """Mixin for typer's classes: rejects repeated options and shows in the help only what the user types."""

    def get_params(self, ctx: Any) -> list[Any]:
        return _plain_flags(super().get_params(ctx))  # type: ignore[misc]

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        given = list(args)
        try:
            rest: list[str] = super().parse_args(ctx, args)  # type: ignore[misc]
        except typer.BadParameter as error:
            error.message = _in_words(error)
            raise
        _refuse_repeats(self, ctx, given)
        return rest


class Command(_Careful, TyperCommand):
    """A command of ``pdgw``."""


class Group(_Careful, TyperGroup):
    """A group of commands. Some groups have options of their own."""

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
        """Name the command of another group that is meant: ``pdgw check`` is ``pdgw config check``."""
        name = args[0]
        if meant := [path for path in EXAMPLES if path.endswith(f" {name}") and name not in self.commands]:
            ctx.fail(f"No such command {name!r}. Did you mean 'pdgw {meant[0]}'?")
        return super().resolve_command(ctx, args)


@dataclass(frozen=True, slots=True)
class Entry:
    """A row of the table: ``target`` is ``module:name`` in ``pdgw.tools.commands`` and names a function or a group."""

    target: str
    help: str

    def load(self, name: str) -> Any:
        """Import the module and make the command."""
        module, _, attribute = self.target.partition(":")
        found = getattr(import_module(f"pdgw.tools.commands.{module}"), attribute)
        gc.enable()
        holder = typer.Typer(add_completion=False, rich_markup_mode=None)
        holder.callback()(lambda: None)  # makes it a group even with a single command
        if isinstance(found, typer.Typer):
            for item in found.registered_commands:
                item.cls = Command
            own = found.info.cls
            holder.add_typer(found, name=name, cls=own if isinstance(own, type) else Group)
        else:
            holder.command(name, cls=Command)(found)
        made = get_command(holder)
        assert isinstance(made, TyperGroup)
        command = made.commands[name]
        group = next((f"{group} " for group, table in GROUPS.items() if self in table.values()), "")
        _complete(command, group + name)
        return command


def _complete(command: Any, name: str) -> None:
    """Add the example of each command to the end of its help, and keep its first sentence whole in the list of its group."""
    command.short_help = command.short_help or (command.help or "").partition("\n\n")[0]
    if name in EXAMPLES:
        command.epilog = f"Example: pdgw {EXAMPLES[name]}"
    for below, item in getattr(command, "commands", {}).items():
        _complete(item, f"{name} {below}")


COMMANDS: Mapping[str, Entry] = {
    "run": Entry(
        "gateway.run:run",
        "Run the gateway until SIGINT, SIGTERM or SIGQUIT; it stops and disables the drives before it ends.",
    ),
    "config": Entry("commissioning.config:app", "Print an example configuration, or check a file."),
    "bus": Entry(
        "commissioning.bus:app", "List the nodes of a CAN bus, or give one its node-ID, without a running gateway."
    ),
    "device": Entry(
        "commissioning.device:app", "Save, compare or write the values of one device, without a running gateway."
    ),
    "axis": Entry("commissioning.axis:app", "Turn an axis for the first time, without a PLC."),
    "map": Entry(
        "commissioning.map:map_",
        "Print the byte map of a configuration, with unit and 100 % of every value, or code for the PLC.",
    ),
    "status": Entry(
        "gateway.status:status",
        "Show why axes are not in operation and one line for each axis; with an axis number, all details of that axis.",
    ),
    "explain": Entry(
        "gateway.status:explain", "Show what happened around the last fault or stop, in at most ten lines."
    ),
    "trace": Entry(
        "gateway.trace:app", "Save or list recordings of the flight recorder: the last minutes of both buses."
    ),
    "web": Entry(
        "gateway.web:web",
        "Serve the status of a running gateway to browsers, Prometheus and MQTT; read-only.",
    ),
    "param": Entry("gateway.param:app", "Read and write parameters of a gateway or of another PROFIdrive device."),
    "decode": Entry(
        "capture.decode:decode",
        "Decode hexadecimal data (--hex), a capture of either bus, or the live frames of a bus.",
    ),
    "timeline": Entry(
        "capture.timeline:timeline",
        "Merge captures of both buses: each command of the PLC with its result, its duration and the reason if it had no effect.",
    ),
    "replay": Entry(
        "capture.timeline:replay",
        "Run a recording through this version of the gateway; exit status 1 if it decides or sends something else.",
    ),
    "drives": Entry(
        "commissioning.drives:drives",
        "List the known drive families, show one, or check EDS and DCF files and list their repairs.",
    ),
    "sim": Entry("simulation.devices:app", "Simulate a PLC, drives, encoders or a bus of devices."),
    "demo": Entry(
        "simulation.demo:demo",
        "Run a PLC, the gateway and simulated drives in chapters; report every expectation as pass or fail.",
    ),
}
"""The commands of ``pdgw``, in the order of the help."""

SIM_COMMANDS: Mapping[str, Entry] = {
    "plc": Entry(
        "simulation.plc:plc",
        "Simulate a PLC with a scenario (exit status 1 if an expectation fails) or the keyboard.",
    ),
    "drive": Entry(
        "simulation.devices:drive",
        "Run simulated drives until SIGINT, SIGTERM or `quit`. Commands on standard input: see `pdgw sim inject`.",
    ),
    "encoder": Entry(
        "simulation.devices:encoder",
        "Run simulated encoders until SIGINT, SIGTERM or `quit`. Commands on standard input: see `pdgw sim inject`.",
    ),
    "bus": Entry(
        "simulation.devices:bus",
        "Run the simulated devices of FILE with their faults until SIGINT, SIGTERM or `quit`; "
        "--serve opens the bus too.",
    ),
    "inject": Entry(
        "simulation.devices:inject",
        "Send a command to running simulated devices, for example a fault.",
    ),
}
"""The commands of ``pdgw sim``."""

BUS_COMMANDS: Mapping[str, Entry] = {
    "scan": Entry(
        "commissioning.bus:scan",
        "List the nodes on a bus, their types and what they lack for each telegram; read-only.",
    ),
    "assign": Entry(
        "commissioning.bus_assign:assign",
        "Give a device its node-ID, and a bit rate if asked, by LSS; store it and read it back.",
    ),
}
"""The commands of ``pdgw bus``."""

DEVICE_COMMANDS: Mapping[str, Entry] = {
    "save": Entry(
        "commissioning.device_save:save",
        "Save what a device has into a DCF, which replaces it at night (key dcf); read-only on the bus.",
    ),
    "compare": Entry(
        "commissioning.device_compare:compare",
        "Compare a device with its values in dcf and objects; exit status 1 if they differ.",
    ),
    "write": Entry(
        "commissioning.device_write:write",
        "Write the values of dcf and objects that a device does not have, while it has no power, and read them back.",
    ),
}
"""The commands of ``pdgw device``."""

GROUPS: Mapping[str, Mapping[str, Entry]] = {
    "bus": BUS_COMMANDS,
    "device": DEVICE_COMMANDS,
    "sim": SIM_COMMANDS,
}
"""Groups whose commands have modules of their own."""


def lazy_group(table: Mapping[str, Entry]) -> type[Group]:
    """The class of a command group (``typer.Typer(cls=...)``) with the commands of a table."""

    class LazyGroup(Group):
        """Lists placeholders that have only a help line, and loads a command when it is called."""

        def __init__(self, **attributes: Any) -> None:
            super().__init__(**attributes)
            for name, entry in table.items():
                self.add_command(TyperCommand(name, callback=None, short_help=entry.help))

        def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
            name, placeholder, rest = super().resolve_command(ctx, args)
            return name, (placeholder if name is None else table[name].load(name)), rest

    return LazyGroup


EXAMPLES: Mapping[str, str] = {
    "run": "run gateway.toml",
    "config example": "config example > gateway.toml",
    "config check": "config check --bus gateway.toml",
    "bus scan": "bus scan --channel can0",
    "bus assign": "bus assign 5 --channel can0",
    "device save": "device save gateway.toml 1 -o drive.dcf",
    "device compare": "device compare gateway.toml 1",
    "device write": "device write gateway.toml 1 --store",
    "axis test": "axis test 1 gateway.toml --percent 5",
    "map": "map gateway.toml --format scl --out gateway.scl",
    "status": "status 1",
    "explain": "explain 1 --support support.zip",
    "trace save": "trace save stop.pcapng --last 30",
    "trace list": "trace list",
    "trace watch": "trace watch --on fault --to traces",
    "web": "web gateway.toml --listen 127.0.0.1:8420",
    "param read": "param read P922 6041h 1018h.1 --do 1",
    "param write": "param write 6085h 3000 --do 1",
    "param list": "param list --do 1",
    "param describe": "param describe P922",
    "param identify": "param identify --gateway 192.168.0.2",
    "param dump": "param dump axis1.json --do 1",
    "param restore": "param restore axis1.json --do 1 --dry-run",
    "decode": "decode plc.pcap --telegram 1 --filter 'stw1.on == 0'",
    "timeline": "timeline plc.pcap can.log --telegram 1",
    "replay": "replay recording/gateway.pcapng",
    "drives": "drives epos4",
    "demo": "demo --chapter basics",
    "sim plc": "sim plc turn.yaml --gateway 127.0.0.1",
    "sim drive": "sim drive --channel can0 --node-id 1",
    "sim encoder": "sim encoder --channel can0 --node-id 10 --motion speed=1.5",
    "sim bus": "sim bus devices.toml --serve",
    "sim inject": "sim inject --port 5000 fault slow-sdo delay_ms=100",
}
"""An example of each command for its help, without the leading ``pdgw``."""
