"""Check the references of a configuration without devices: CAN interfaces and data sheets."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from pdgw.base.validation import Problem
from pdgw.ds301.aborts import CanopenError
from pdgw.gateway.configuration.axis_config import AxisConfig
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.devices import EncoderConfig
from pdgw.gateway.configuration.toml_file import problem_text, read_text


def references_wrong(config: GatewayConfig, path: Path) -> list[str]:
    """One line for each CAN interface that cannot be opened on this machine and each data sheet that cannot be used."""
    text = read_text(path)
    found = [*_interfaces(config), *_sheets("axis", config.axis), *_sheets("encoder", config.encoder)]
    return [problem_text(problem, text, str(path)) for problem in found]


def _interfaces(config: GatewayConfig) -> Iterator[Problem]:
    from pdgw.ds301.bus.interfaces import obstacle  # noqa: PLC0415 (slow to load)

    for number, bus in enumerate(config.can):
        wrong = obstacle(bus.interface)
        if wrong:
            yield Problem(("can", number, "interface"), repr(bus.interface), wrong)


def _sheets(section: str, items: Sequence[AxisConfig | EncoderConfig]) -> Iterator[Problem]:
    for number, item in enumerate(items):
        key = "dcf" if item.eds == item.dcf else "eds"
        if item.eds is not None and (wrong := _sheet(item)):
            yield Problem((section, number, key), repr(str(item.eds)), wrong)
            continue
        try:
            item.device_values(section)
        except CanopenError as error:
            yield Problem((section, number, "objects" if item.objects else "dcf"), "", str(error))


def _sheet(item: AxisConfig | EncoderConfig) -> str:
    """Why a data sheet cannot be used, in the words of ``pdgw run``; empty when it can."""
    from pdgw.dsp402.drive.client import load_eds as load_drive  # noqa: PLC0415 (slow to load)
    from pdgw.dsp406.encoder import load_eds as load_encoder  # noqa: PLC0415

    assert item.eds is not None
    load = load_drive if isinstance(item, AxisConfig) else load_encoder
    try:
        load(item.eds, item.node_id)
    except CanopenError as error:
        first, *more = error.allowed.splitlines()
        return f"is not {first}" + (f" (and {len(more)} more, see pdgw drives)" if more else "")
    return ""
