"""Documents as text: one line, or the full tree."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from profidrive.signals import SIGNALS

Document = dict[str, Any]


def _signal_text(name: str, item: Document) -> str:
    width = 2 * SIGNALS[name].type.size
    if item["unit"] == "%":
        return f"{name} {item['value']:.3f} %"
    if item["bits"]:
        return f"{name} {item['raw']:0{width}X}h"
    return f"{name} {item['raw']}" + (f" {item['unit']}" if item["unit"] else "")


def _parameter_text(item: Document) -> str:
    parts = []
    if "pnu" in item:
        pnu = item["pnu"]
        # 1:1 objects are better known by their CANopen index.
        name = f"{pnu:04X}h" if 1000 <= pnu < 60000 else f"P{pnu}"
        parts.append(f"{name}.{item['subindex']}")
        if item["elements"] > 1:
            parts.append(f"x{item['elements']}")
        if item["attribute"] != "value":
            parts.append(item["attribute"])
    if "text" in item:
        parts.append(f"= {item['text']}" if "pnu" in item else item["text"])
    return " ".join(parts)


def one_line(document: Document) -> str:
    """The whole document in one line."""
    parts = [document["kind"]]
    if "frame_id" in document:
        parts.append(f"FrameID {document['frame_id']:04X}h counter {document['cycle_counter']}")
    if "telegram" in document:
        parts.append(f"telegram {document['telegram']} {document['direction']}")
    if "service" in document:
        parts.append(f"{document['service']} ref {document['reference']} DO {document['do_id']}")
    parts += [_signal_text(name, item) for name, item in document["signals"].items()]
    parts += [_parameter_text(item) for item in document.get("parameters", ())]
    return " | ".join(parts)


def tree(document: Document) -> Iterator[str]:
    """Every field on a line of its own; of the bits, all with their values."""
    yield f"{document['kind']}: {document['why']}"
    for key, value in document.items():
        if key not in {"kind", "why", "signals", "parameters"}:
            yield f"  {key}: {value}"
    for name, item in document["signals"].items():
        yield f"  {_signal_text(name, item)}  ({SIGNALS[name].description})"
        for bit, value in item["bits"].items():
            yield f"    {bit} = {value}"
    for item in document.get("parameters", ()):
        yield f"  {_parameter_text(item)}"
