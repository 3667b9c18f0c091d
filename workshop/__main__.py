"""``python -m pdgw.workshop``: benchmarks, conformance tests and soak of the gateway."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

from pdgw.tools.cli import command_line, main
from pdgw.tools.command_table import Entry

_Entry = partial(Entry, package="pdgw.workshop.commands")

COMMANDS: Mapping[str, Entry] = {
    "bench": _Entry("bench:app", "Benchmarks."),
    "conformance": _Entry("conformance:app", "Conformance tests of the gateway."),
    "soak": _Entry(
        "soak:soak",
        "Run a day of random PLC words and faults in virtual time; exit status 1 if a rule is violated.",
    ),
}
"""The commands of the workshop in the order of its help."""

app = command_line("python -m pdgw.workshop", COMMANDS, "Benchmarks, conformance tests and soak of the gateway.")


if __name__ == "__main__":
    main(app)
