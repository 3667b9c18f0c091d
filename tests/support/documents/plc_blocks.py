"""Tables of the inputs and outputs of the PLC blocks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from pdgw.profidrive.telegrams import TELEGRAMS
from pdgw.tools.plc.code import has_axis, motion_blocks
from pdgw.tools.plc.declarations import Declared, declarations
from pdgw.tools.plc.library import axis_block, block_name, telegram_block, template
from tests.support.documents.parts import numbers, table

_DOCS = Path(__file__).parents[3] / "docs"
BLOCKS_PATH = _DOCS / "plc-blocks.md"
_SECTIONS = {"VAR_INPUT": "in", "VAR_OUTPUT": "out", "VAR_IN_OUT": "in and out"}
_COMMON = {
    ("Axis", ""),
    ("Execute", "FALSE to TRUE starts it"),
    ("Busy", "the command is active"),
    ("ErrorID", "number of the reason"),
}
"""Variables of PLCopen's blocks that the introduction describes."""
_INTRODUCTION = """\
# Function blocks for a PLC: inputs and outputs

For the PLC programmer who uses a block. Generated from the templates by `make docs`; do not edit. [plc.md](plc.md)
shows how to use them. "Telegrams" is empty if all telegrams of the block have the variable. `Actual` and `Setpoints`
are the structures of the telegram.

The tables leave out `Axis` (in and out, PDGW_AXIS) of `PDGW_Axis_Tn` and of all `MC_...` blocks, and what is equal in every
`MC_...` block that has it: `Execute` starts the command when it becomes TRUE, `Busy` is TRUE while the command is active,
`ErrorID` is the number of the reason of an `Error`. Blocks with `Done` or `InVelocity` have `Execute` and `Busy`, all have
`ErrorID`.

![Signals of MC_Power, MC_Home and MC_MoveAbsolute, and the position](plc-timing.svg)
"""


def generate_blocks() -> str:
    """Generate the document."""
    families: dict[str, dict[int, str]] = {}
    for number, item in TELEGRAMS.items():
        families.setdefault(block_name(item).rpartition("_")[0], {})[number] = telegram_block(item, {})
        if has_axis(item):
            families.setdefault("PDGW_Axis", {})[number] = axis_block(item, {})
    parts = [_INTRODUCTION]
    parts += [_family(name, texts) for name, texts in families.items()]
    for text in [template("parameter"), *motion_blocks()]:
        for unit in declarations(text):
            if unit.kind != "TYPE":
                rows = _rows({0: unit.variables})
                rows_text = table(("", "name", "type", "meaning"), rows)
                parts.append(f"## {unit.name}\n\n{unit.comment}\n\n{rows_text}")
    return "\n".join(parts)


def _family(name: str, texts: dict[int, str]) -> str:
    found = {number: next(iter(declarations(text))) for number, text in texts.items()}
    rows = _rows({number: item.variables for number, item in found.items()})
    rows_text = table(("", "name", "type", "meaning", "telegrams"), rows)
    return f"## {name}_Tn\n\nTelegrams {numbers(found)}.\n\n{rows_text}"


def _rows(variables: dict[int, Sequence[Declared]]) -> Iterator[tuple[str, ...]]:
    """Each variable once, with the telegrams that have it. A single block has no telegrams in its rows."""
    merged: dict[tuple[str, str], dict[int, Declared]] = {}
    for number, declared in variables.items():
        for item in declared:
            if item.section in _SECTIONS and item.name not in {"Actual", "Setpoints", "Wanted"}:
                merged.setdefault((item.section, item.name), {})[number] = item
    for section, direction in _SECTIONS.items():
        for (of, name), items in merged.items():
            if of == section:
                types = dict.fromkeys(item.type for item in items.values())
                initial = "".join(
                    dict.fromkeys(f" (initially {item.initial})" for item in items.values() if item.initial)
                )
                comments = dict.fromkeys(item.comment for item in items.values())
                telegrams = () if 0 in items else ("" if len(items) == len(variables) else numbers(items),)
                said = next(iter(comments)) if len(comments) == 1 or name != "ModePos" else max(comments, key=len)
                if (name, said) not in _COMMON:
                    yield direction, f"`{name}`", ", ".join(types), said + initial, *telegrams


if __name__ == "__main__":
    BLOCKS_PATH.write_text(generate_blocks(), encoding="utf-8")
