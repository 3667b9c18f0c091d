"""The rooms as a picture in architecture.md: a line to each room that one may import, and that no other line leads to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from tests.support.documents.parts import DOCS
from tests.test_package_imports import FLOORS, FOR_ALL, ROWS, room_of

PATH: Final = DOCS / "packages.svg"
_GATEWAY: Final = "gateway"
_WIDTH, _HEIGHT, _GAP, _ROW = 128, 26, 14, 46
"""Pixels: a box, the gap beside it, from row to row."""
_MARGIN: Final = 12
_SVG: Final = """\
<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" font-size="13">
<rect width="{width}" height="{height}" fill="white"/>
{shapes}
</svg>
"""


def generate() -> str:
    """An SVG of the rows that the test of imports has; each room is above all rooms that it imports."""
    lines = _lines()
    rows = _rows(lines)
    places = _places(lines, rows)
    bottom = max(rows.values())
    shapes = []
    for room, others in lines.items():
        for other in others:
            crossed = range(rows[room] - 1, rows[other], -1)
            xs = [places[room], *(places[room, other, row] for row in crossed), places[other]]
            ends = [(round(x), (bottom - rows[room] + step) * _ROW + _MARGIN) for step, x in enumerate(xs)]
            path = f"M{ends[0][0]},{ends[0][1] + _HEIGHT}"
            for x, y in ends[1:]:
                path += f" S{x},{y - _ROW + _HEIGHT} {x},{y}" + (f" V{y + _HEIGHT}" if (x, y) != ends[-1] else "")
            shapes.append(f'<path d="{path}" fill="none" stroke="#1f4e8c"/>')
    for room, row in rows.items():
        x, y = round(places[room]) - _WIDTH // 2, (bottom - row) * _ROW + _MARGIN
        fill = "#e3ecf7" if room.startswith(_GATEWAY) else "#f4f4f4"
        shapes.append(f'<rect x="{x}" y="{y}" width="{_WIDTH}" height="{_HEIGHT}" rx="4" fill="{fill}" stroke="#555"/>')
        shapes.append(f'<text x="{x + _WIDTH // 2}" y="{y + 17}" text-anchor="middle">{room.replace(".", "/")}</text>')
    width = round(max(places[room] for room in rows)) + _WIDTH // 2 + _MARGIN
    return _SVG.format(shapes="\n".join(shapes), width=width, height=bottom * _ROW + _HEIGHT + 2 * _MARGIN)


def _lines() -> dict[str, list[str]]:
    """The rooms from the ground up, with those to which a line leads."""
    imported = _imported()
    beyond = {room: set().union(*(_below(imported, other) for other in others)) for room, others in imported.items()}
    return {room: [other for other in imported if other in others - beyond[room]] for room, others in imported.items()}


def _rows(lines: Mapping[str, Sequence[str]]) -> dict[str, int]:
    """The row of each room, from 0 on the ground."""
    rows: dict[str, int] = {}
    for room, others in lines.items():
        rows[room] = 1 + max((rows[other] for other in others), default=-1)
    return rows


def _places(lines: Mapping[str, Sequence[str]], rows: Mapping[str, int]) -> dict[object, float]:
    """The middle of each room, and that of each line (room, other room, row) in a row that it crosses, in pixels.

    Each is near to what is below it.
    """
    places: dict[object, float] = {}
    for row in range(max(rows.values()) + 1):
        below: dict[object, list[float]] = {room: [] for room in lines if rows[room] == row}
        for room, others in lines.items():
            for other in others:
                under = other if rows[other] == row - 1 else (room, other, row - 1)
                if rows[other] < row <= rows[room]:
                    below.setdefault(room if rows[room] == row else (room, other, row), []).append(places[under])
        free = float(_MARGIN)
        middles = {item: sum(xs) / len(xs) if xs else 0 for item, xs in below.items()}
        for item in sorted(middles, key=middles.__getitem__):
            half = _WIDTH / 2 if item in rows else _GAP / 2
            places[item] = max(middles[item], free + half)
            free = places[item] + half + _GAP
    return places


def _imported() -> dict[str, set[str]]:
    """The rooms from the ground up, with those that they import; without the one that all import."""
    rooms = [room for floor in FLOORS for room in floor if room not in FOR_ALL]
    imported: dict[str, set[str]] = {room: set() for room in rooms}
    for package, row in ROWS.items():
        for item in row.split():
            found = [room for room in rooms if "." in room] if item == _GATEWAY else [room_of(item)]
            if room_of(package) in imported:
                imported[room_of(package)].update(found)
    return {room: others - {room} for room, others in imported.items()}


def _below(imported: dict[str, set[str]], room: str) -> set[str]:
    """Every room that a room imports directly or through others."""
    return imported[room].union(*(_below(imported, other) for other in imported[room]))
