"""What a configuration refers to, checked as far as that is possible without a device: CAN interfaces and data sheets."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from pdgw.ds301.errors import CanopenError
from pdgw.dsp402.objects import DRIVE_OBJECTS
from pdgw.dsp406.pdo import POSITION, POSITION_MULTI_SENSOR
from pdgw.gateway.config import AxisConfig, EncoderConfig, GatewayConfig
from pdgw.gateway.config_file import SECTIONS
from pdgw.gateway.explain import Problem
from pdgw.gateway.toml_file import read_text, told

_CONTROLWORD: Final = DRIVE_OBJECTS.attribute("controlword")


def references_wrong(config: GatewayConfig, path: Path) -> list[str]:
    """One line for each CAN interface python-can does not know and each data sheet that cannot be used."""
    text = read_text(path)
    found = [*_interfaces(config), *_sheets("axis", config.axis), *_sheets("encoder", config.encoder)]
    return [told(problem, text, str(path), SECTIONS) for problem in found]


def _interfaces(config: GatewayConfig) -> Iterator[Problem]:
    from can.interfaces import VALID_INTERFACES  # noqa: PLC0415 (slow to load)

    for number, bus in enumerate(config.can):
        if bus.interface not in VALID_INTERFACES:
            close = difflib.get_close_matches(bus.interface, VALID_INTERFACES, n=1)
            hint = f"did you mean {close[0]}? " if close else ""
            allowed = ", ".join(sorted(VALID_INTERFACES))
            yield Problem(
                ("can", number, "interface"),
                repr(bus.interface),
                f"no interface of python-can, {hint}allowed: {allowed}",
            )


def _sheets(section: str, items: Sequence[AxisConfig | EncoderConfig]) -> Iterator[Problem]:
    for number, item in enumerate(items):
        wrong = _sheet(item) if item.eds is not None else ""
        if wrong:
            yield Problem((section, number, "eds"), repr(str(item.eds)), wrong)


def _sheet(item: AxisConfig | EncoderConfig) -> str:
    """Why a data sheet cannot be used; empty when it can."""
    from pdgw.ds301.eds_import import import_eds  # noqa: PLC0415 (slow to load)

    assert item.eds is not None
    try:
        dictionary = import_eds(item.eds, item.node_id).dictionary
    except CanopenError as error:
        first, *more = str(error).splitlines()
        return first + (f" (and {len(more)} more, see pdgw eds check)" if more else "")
    if isinstance(item, AxisConfig):
        needed = {_CONTROLWORD.index: f"{_CONTROLWORD.name} {_CONTROLWORD.index:04X}h of a drive"}
    else:
        needed = dict.fromkeys((POSITION, POSITION_MULTI_SENSOR), f"position {POSITION:04X}h of an encoder")
    if any(index in dictionary for index in needed):
        return ""
    return f"has no {next(iter(needed.values()))}: is it the data sheet of another device?"
