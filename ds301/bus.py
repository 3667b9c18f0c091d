"""Opening a python-can bus, with errors a user can act on."""

from __future__ import annotations

import can
from pdgw.ds301.errors import CanopenError


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
    except (can.CanError, OSError, ValueError, TypeError, ImportError, NotImplementedError) as error:
        raise CanopenError(
            "CAN interface", f"{interface} channel {channel}", f"a reachable python-can bus ({error})"
        ) from error
