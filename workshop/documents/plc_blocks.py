"""The inputs and outputs of the blocks for a PLC as tables, and a timing diagram of a task that ran in virtual time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from pdgw.gateway.configuration.byte_map import frame_maps
from pdgw.gateway.configuration.example import simulated
from pdgw.gateway.daemon import Daemon
from pdgw.peers.plc.structured_text.controller import Controller
from pdgw.peers.world import World
from pdgw.profidrive.telegrams import TELEGRAMS, telegram
from pdgw.tools.plc.code import structured_text
from pdgw.tools.plc.declarations import Declared, declarations
from pdgw.tools.plc.library import axis_block, block_name, telegram_block, template
from pdgw.tools.plc.motion import has_axis, motion_blocks
from pdgw.workshop.documents.markdown import table

_DOCS = Path(__file__).parents[2] / "docs"
BLOCKS_PATH, TIMING_PATH = _DOCS / "plc-blocks.md", _DOCS / "plc-timing.svg"
_SECTIONS = {"VAR_INPUT": "in", "VAR_OUTPUT": "out", "VAR_IN_OUT": "in and out"}
_INTRODUCTION = f"""\
# Function blocks for a PLC: inputs and outputs

Generated from the templates by `make docs`; do not edit. How to use them: [plc.md](plc.md). "Telegrams" is empty where all
telegrams of the block have the variable. `Actual` and `Setpoints` are the structures of the telegram.

## Timing of a task

![Signals of PDGW_Pos_T111 during an absolute task]({TIMING_PATH.name})

An absolute task of `PDGW_Pos_T111` with a simulated drive in virtual time, 4 ms per cycle. The block holds STW1.6 until ZSW1.12
answers.
"""


def generate_blocks() -> str:
    """The whole document."""
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
                parts.append(
                    f"## {unit.name}\n\n{unit.comment}\n\n{table(('', 'name', 'type', 'initial', 'meaning'), rows)}"
                )
    return "\n".join(parts)


def _family(name: str, texts: dict[int, str]) -> str:
    found = {number: next(iter(declarations(text))) for number, text in texts.items()}
    numbers = ", ".join(map(str, found))
    rows = _rows({number: item.variables for number, item in found.items()})
    return f"## {name}_Tn\n\nTelegrams {numbers}.\n\n{table(('', 'name', 'type', 'initial', 'meaning', 'telegrams'), rows)}"


def _rows(variables: dict[int, Sequence[Declared]]) -> Iterator[tuple[str, ...]]:
    """Each variable once, with the telegrams that have it; ``variables`` of one block alone have none."""
    merged: dict[tuple[str, str], dict[int, Declared]] = {}
    for number, declared in variables.items():
        for item in declared:
            if item.section in _SECTIONS and item.name not in {"Actual", "Setpoints", "Wanted"}:
                merged.setdefault((item.section, item.name), {})[number] = item
    for section, direction in _SECTIONS.items():
        for (of, name), items in merged.items():
            if of == section:
                types = dict.fromkeys(item.type for item in items.values())
                initials = dict.fromkeys(item.initial for item in items.values())
                comments = dict.fromkeys(item.comment for item in items.values())
                telegrams = () if 0 in items else ("" if len(items) == len(variables) else ", ".join(map(str, items)),)
                said = next(iter(comments)) if len(comments) == 1 or name != "ModePos" else max(comments, key=len)
                yield direction, f"`{name}`", ", ".join(types), "".join(initials), said, *telegrams


class Trace(NamedTuple):
    """A signal over the cycles: a number for each."""

    name: str
    values: list[float]


def timing(number: int = 111) -> list[Trace]:
    """The signals of an absolute task behind a homing, as they were in a gateway and a simulated drive."""
    config = simulated([number])
    sending, receiving = frame_maps(config)
    (axis,) = config.axis
    controller = Controller(
        structured_text(config),
        f"""PROGRAM Main
VAR_INPUT received : ARRAY[0..{receiving.size - 1}] OF BYTE; END_VAR
VAR_OUTPUT sent : ARRAY[0..{sending.size - 1}] OF BYTE; END_VAR
VAR read : PDGW_Read; drive : {block_name(telegram(number))}; build : PDGW_Build; END_VAR
    read(frame := received);
    drive(Actual := read.axis_{axis.do_id}, Good := read.good_{axis.do_id}, PositionFactor := 1.0, VelocityFactor := 1.0);
    build(axis_{axis.do_id} := drive.Setpoints, good_{axis.do_id} := read.good_{axis.do_id}, frame => sent);
END_PROGRAM""",
    )
    drive = controller.variables["DRIVE"]
    world = World()
    world.simulate(config)
    gateway = Daemon(config, world)
    gateway.start()
    port = world.network.open("plc", 0, "PLC")
    newest: list[bytes] = []

    def take() -> None:
        while (datagram := port.receive()) is not None:
            newest[:] = [datagram[0]]

    port.start(take)
    seen: list[dict[str, float]] = []

    def exchange(cycles: int, **inputs: object) -> None:
        drive.update({name.upper(): value for name, value in inputs.items()})
        for _ in range(cycles):
            port.send(controller.cycle(world.loop.now(), newest.pop() if newest else None), gateway.address)
            world.loop.run_for(gateway.cycle_ns)
            control, status = drive["SETPOINTS"]["STW1"], drive["ACTUAL"]["ZSW1"]
            seen.append(
                {
                    "Execute": drive["EXECUTE"],
                    "STW1.6": bool(control & 1 << 6),
                    "ZSW1.12": bool(status & 1 << 12),
                    "Busy": drive["BUSY"],
                    "InPosition": drive["INPOSITION"],
                    "Done": drive["DONE"],
                    "ActPosition": drive["ACTPOSITION"],
                }
            )

    while not drive["READY"]:
        exchange(1)
    exchange(1)
    exchange(100, Enable=True)
    exchange(100, ModePos=4, Execute=True)
    exchange(20, Execute=False)
    seen.clear()
    exchange(3)
    exchange(60, ModePos=2, Position=6000.0, Velocity=6000.0, Execute=True)
    exchange(30, Execute=False)
    gateway.stop()
    world.loop.until(gateway.stopped.is_set, "the end of the gateway")
    return [Trace(name, [float(sample[name]) for sample in seen]) for name in seen[0]]


_LEFT, _WIDE, _HIGH, _ROW = 110, 7, 22, 40


def timing_svg(traces: Sequence[Trace], cycle_ms: float) -> str:
    """A timing diagram: a step line for each signal, a scale of time below."""
    cycles = len(traces[0].values)
    width, height = _LEFT + cycles * _WIDE + 20, len(traces) * _ROW + 40
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" font-size="13">',
        f'<rect width="{width}" height="{height}" fill="white"/>',
    ]
    for row, trace in enumerate(traces):
        top = max(*trace.values, 1.0)
        base = (row + 1) * _ROW - 4
        points: list[str] = []
        for place, value in enumerate(trace.values):
            x, y = _LEFT + place * _WIDE, f"{base - value / top * _HIGH:.1f}"
            if not points or not points[-1].endswith(f",{y}"):
                points += [f"{x},{points[-1].partition(',')[2]}"] if points else []
                points.append(f"{x},{y}")
        points.append(f"{_LEFT + cycles * _WIDE},{points[-1].partition(',')[2]}")
        out.append(f'<text x="8" y="{base}">{trace.name}</text>')
        out.append(f'<polyline points="{" ".join(points)}" fill="none" stroke="#1f4e8c" stroke-width="1.6"/>')
    for place in range(0, cycles, 25):
        x = _LEFT + place * _WIDE
        out.append(f'<text x="{x}" y="{height - 12}">{place * cycle_ms:g} ms</text>')
        out.append(f'<line x1="{x}" y1="8" x2="{x}" y2="{height - 28}" stroke="#bbb" stroke-dasharray="3 3"/>')
    return "\n".join([*out, "</svg>", ""])


def generate_timing() -> str:
    """The picture."""
    return timing_svg(timing(), simulated([111]).transport.cycle_time_ms)


if __name__ == "__main__":
    BLOCKS_PATH.write_text(generate_blocks(), encoding="utf-8")
    TIMING_PATH.write_text(generate_timing(), encoding="utf-8")
