"""Opening a python-can bus, with errors a user can act on."""

from __future__ import annotations

import errno

import can

from pdgw.ds301.errors import CanopenError


def system_text(error: OSError, channel: object, bitrate: int | None = None) -> str:
    """The system's error text for a CAN interface, with the remedy if there is a command for it."""
    text = error.strerror or str(error)
    name = channel if isinstance(channel, str) and channel else "can0"
    if error.errno == errno.ENETDOWN:
        return f"{text}; bring it up: sudo ip link set {name} up type can bitrate {bitrate or 'BITRATE'}"
    if error.errno == errno.ENODEV:
        return f"{text}; list the existing ones: ip link show type can"
    if error.errno == errno.EAFNOSUPPORT:
        return f"{text}; load the kernel's CAN modules: sudo modprobe can-raw"
    return text


def open_bus(
    interface: str, channel: str | int | None = None, bitrate: int | None = None, **extra: object
) -> can.BusABC:
    """A bus of any python-can interface; ``extra`` goes to it unchanged.

    CanopenError names interface and channel when the driver is missing or the channel cannot be reached.
    """
    settings: dict[str, object] = {"interface": interface, "ignore_config": True, **extra}
    if channel is not None:
        settings["channel"] = channel
    if bitrate is not None:
        settings["bitrate"] = bitrate
    try:
        return can.Bus(**settings)  # type: ignore[arg-type]
    except Exception as error:  # drivers raise any exception
        text = system_text(error, channel, bitrate) if isinstance(error, OSError) and error.errno else str(error)
        text = text or type(error).__name__
        raise CanopenError(
            "CAN interface", f"{interface} channel {channel}", f"a python-can bus that can be opened ({text})"
        ) from error
