"""The gateway as a PROFINET device: identity and model from the configuration."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import date

from pdgw.durations import MS
from pdgw.gateway import identity
from pdgw.gateway.configuration.config import AxisConfig
from pdgw.gateway.configuration.tables.encoder import EncoderConfig
from pdgw.gateway.configuration.tables.environment import TransportConfig
from pdgw.profidrive.frame import COUNTER_UNIT_NS
from pdgw.profidrive.telegrams import Telegram
from pdgw.profinet.model import SEND_CLOCKS, DeviceModel, ObjectKind, drive_model
from pdgw.profinet.station import Identity

PRODUCT = "profidrive-gateway"
"""Also the name that engineering tools propose for the station."""
VENDOR_NAME = "pdgw"
RELEASED = date(identity.RELEASE_YEAR, identity.RELEASE_DAY_MONTH % 100, identity.RELEASE_DAY_MONTH // 100)


def profinet_identity(transport: TransportConfig, mac: bytes) -> Identity:
    """Identity of the device."""
    return Identity(
        mac,
        transport.vendor_id,
        transport.device_id,
        PRODUCT,
        identity.ORDER_ID,
        transport.station_name[:16],
        identity.HARDWARE_REVISION,
        ("V", *identity.RELEASE),
    )


def min_device_interval(transport: TransportConfig) -> int:
    """Shortest cycle of a controller in 31.25 us: 1 ms, or less if the configured cycle is shorter."""
    return next(
        (clock for clock in SEND_CLOCKS if clock * COUNTER_UNIT_NS >= transport.cycle_time_ms * MS), SEND_CLOCKS[-1]
    )


def profinet_model(
    transport: TransportConfig, mac: bytes, objects: Sequence[AxisConfig | EncoderConfig], telegrams: Sequence[Telegram]
) -> DeviceModel:
    """A slot for each drive object, in the order of the configuration."""
    kinds = [ObjectKind.AXIS if isinstance(item, AxisConfig) else ObjectKind.ENCODER for item in objects]
    identified = list(zip(kinds, telegrams, strict=True))
    device = profinet_identity(transport, mac)
    return drive_model(device, identified, min_device_interval(transport))
