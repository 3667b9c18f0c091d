"""A first configuration of what a scan has found: the keys that have no default, and as comments what a person must decide."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from pdgw.ds301.communication import NODE_IDS
from pdgw.dsp402.modes import Mode
from pdgw.dsp406.kinds import LINEAR_TYPES, EncoderType
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.commissioning.scan import FoundNode
from pdgw.gateway.commissioning.telegram_check import missing_lines
from pdgw.gateway.configuration.devices import EncoderModel
from pdgw.gateway.configuration.environment import CanConfig
from pdgw.gateway.configuration.toml_file import toml_text
from pdgw.profidrive.telegrams import TELEGRAMS

_NEXT = "# Written by pdgw bus scan. Next: pdgw config check, pdgw axis test 1, pdgw run, each with the name of this file.\n"
_TRANSPORT = """\
# Without these keys only a PLC on this machine reaches the gateway (docs/plc.md).
# [transport]
# listen = "192.168.0.5"  # address of this machine towards the PLC
# peer = "192.168.0.10"   # address of the PLC
"""


def draft(bus: CanConfig, found: Collection[FoundNode]) -> str:
    """The text of a configuration file. GatewayError if no node is a drive or an encoder with a telegram."""
    place = {"interface": bus.interface, "channel": bus.channel, "bitrate": bus.bitrate}
    if free := _free_node_id(bus.node_id, found):
        place["node_id"] = free
    parts = [_NEXT, toml_text({"can": place}), _TRANSPORT]
    number = 0
    for node in found:
        usable = [telegram for telegram, lacking in node.lacks.items() if not lacking]
        fits = f", usable with telegrams {', '.join(map(str, usable))}" if usable else ""
        comments = [f"node {node.node_id}: {node.name!r}{fits}", *node.notes]
        telegram = _telegram(node)
        if telegram is None:
            parts.append(_commented(comments))
            continue
        number += 1
        keys: dict[str, object] = {"do_id": number, "node_id": node.node_id, "telegram": telegram}
        if node.eds is not None:
            keys["eds"] = str(node.eds.absolute())
        if node.drive is not None:
            table = toml_text({"axis": [keys]}) + _commented(missing_lines(node.drive, TELEGRAMS[telegram]))
        else:
            table = toml_text({"encoder": [keys | {"model": _model(node)}]})
        parts.append(_commented(comments) + table)
    if not number:
        raise GatewayError("the scan found no drive and no encoder with a telegram; no configuration is written")
    return "\n".join(parts)


def _free_node_id(own: int, found: Collection[FoundNode]) -> int:
    """The highest one that no device has, for the gateway; 0 if no device has its own."""
    used = {node.node_id for node in found}
    return max(set(NODE_IDS) - used, default=0) if own in used else 0


def _commented(lines: Iterable[str]) -> str:
    return "".join(f"# {' '.join(line.split())}\n" for line in lines)


def _telegram(node: FoundNode) -> int | None:
    """Of a drive speed, else positioning, else transparent; of an encoder its first. The configuration can set unknown units."""
    drive = node.drive
    if drive is None:
        return next((number for number, lacking in node.lacks.items() if not lacking), None)
    offered = {1: drive.speed_mode is not None, 9: Mode.POSITION in drive.modes, 100: True}
    for number, has_mode in offered.items():
        if has_mode and (not node.lacks[number] or missing_lines(drive, TELEGRAMS[number])):
            return number
    return None


def _model(node: FoundNode) -> EncoderModel:
    kind = (node.device_type or 0) >> 16
    if kind == EncoderType.MULTI_SENSOR:
        return EncoderModel.MULTI_SENSOR
    return EncoderModel.LINEAR if kind in LINEAR_TYPES else EncoderModel.ROTARY
