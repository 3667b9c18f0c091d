"""Write the device description for engineering tools (GSDML)."""

from __future__ import annotations

from pathlib import Path

from pdgw.gateway.axis.telegrams import DRIVE_TELEGRAM_NUMBERS, ENCODER_TELEGRAM_NUMBERS
from pdgw.gateway.configuration.tables.environment import TransportConfig
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.links.profinet.identity import (
    PRODUCT,
    RELEASED,
    VENDOR_NAME,
    min_device_interval,
    profinet_identity,
)
from pdgw.profidrive.telegrams import telegram
from pdgw.profinet.gsdml import GsdmlWriter, Snmp, file_name
from pdgw.profinet.model import ObjectKind

TELEGRAMS = {ObjectKind.AXIS: DRIVE_TELEGRAM_NUMBERS, ObjectKind.ENCODER: ENCODER_TELEGRAM_NUMBERS}
_NO_MAC = bytes(6)


def write_gsdml(transport: TransportConfig, folder: Path, option: str) -> Path:
    """Write the file to a folder. GatewayError names the ``option`` of the folder when writing fails."""
    kinds = {kind: [telegram(number) for number in numbers] for kind, numbers in TELEGRAMS.items()}
    snmp = Snmp.NONE if transport.snmp_community is None else Snmp.READ
    if transport.snmp_write_community is not None:
        snmp = Snmp.WRITE
    device, interval = profinet_identity(transport, _NO_MAC), min_device_interval(transport)
    text = GsdmlWriter(device, VENDOR_NAME, kinds, snmp=snmp, min_device_interval=interval).write()
    path = folder / file_name(VENDOR_NAME, PRODUCT, RELEASED)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise GatewayError(f"{option} {folder}: {path.name} cannot be written ({error.strerror or error})") from error
    return path
