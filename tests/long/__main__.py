"""``python -m tests.long``: benchmarks of the gateway."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

from pdgw.tools.cli import command_line, main
from pdgw.tools.command_table import Entry

_Entry = partial(Entry, package="tests.long.commands")

COMMANDS: Mapping[str, Entry] = {
    "bench": _Entry("bench:app", "Benchmarks."),
}
"""The commands in the order of the help."""

app = command_line("python -m tests.long", COMMANDS, "Benchmarks of the gateway.")


if __name__ == "__main__":
    main(app)
