"""Identification of the gateway: P964, P975 and I&M0.

The vendor and device numbers are placeholders until the configuration sets others: PI assigns them to the seller of a device.
"""

from __future__ import annotations

from importlib.metadata import version

VENDOR_ID = 0xFFFF
"""Not assigned."""
DEVICE_ID = 0x0402
ORDER_ID = "PDGW"
HARDWARE_REVISION = 1
RELEASE_YEAR = 2026
RELEASE_DAY_MONTH = 2111
"""DDMM."""
RELEASE: tuple[int, int, int] = tuple(int(part) for part in version("profidrive-gateway").split("."))  # type: ignore[assignment]
FIRMWARE_VERSION = RELEASE[0] * 100 + RELEASE[1]
"""As P964 and P975 show it: 123 is 1.23."""


def unit(vendor_id: int, device_id: int) -> tuple[int, int, int, int, int]:
    """First elements of P964 and P975: manufacturer, type, version, date of the release."""
    return vendor_id, device_id, FIRMWARE_VERSION, RELEASE_YEAR, RELEASE_DAY_MONTH
