"""``python -m tests.long``: benchmarks and conformance tests of the gateway."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

from pdgw.tools.cli import command_line, main
from pdgw.tools.command_table import Entry

_Entry = partial(Entry, package="tests.long.commands")

COMMANDS: Mapping[str, Entry] = {
    "bench": _Entry("bench:app", "Benchmarks."),
    "conformance": _Entry("conformance:app", "Conformance tests of the gateway."),
}
"""The commands in the order of the help."""

app = command_line("python -m tests.long", COMMANDS, "Benchmarks and conformance tests of the gateway.")


if __name__ == "__main__":
    main(app)
