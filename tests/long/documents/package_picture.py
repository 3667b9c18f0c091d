"""The rooms as a picture in architecture.md: an arrow to each room that one may import, and that no other arrow leads to."""

from __future__ import annotations

from typing import Final

from tests.test_package_imports import FLOORS, ROWS, room_of

PLACE: Final = ("architecture.md", "packages")
_GATEWAY: Final = "gateway"


def generate() -> str:
    """A Mermaid diagram of the rows that the test of imports holds."""
    imported = _imported()
    lines = ["```mermaid", "flowchart TD", f'    subgraph {_GATEWAY} ["{_GATEWAY}/"]']
    lines += [f"        {_node(room)}[{room.partition('.')[2]}]" for room in imported if "." in room]
    lines.append("    end")
    for room, others in imported.items():
        beyond = set().union(*(_below(imported, other) for other in others))
        lines += [f"    {_node(room)} --> {_node(other)}" for other in imported if other in others - beyond]
    return "\n".join([*lines, "```"]) + "\n"


def _imported() -> dict[str, set[str]]:
    """The rooms from the ground up, with those that they import."""
    rooms = [room for floor in FLOORS for room in floor]
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


def _node(room: str) -> str:
    return room.replace(".", "_")
