"""The error of damaged captures."""

from __future__ import annotations

from pdgw.gateway.errors import GatewayError


class CaptureError(GatewayError):
    """A capture cannot be read any further. The text names the source, the offset in bytes and the error."""

    def __init__(self, source: str, offset: int | None, what: str) -> None:
        self.source = source
        self.offset = offset
        where = "" if offset is None else f"offset {offset}: "
        super().__init__(f"{source}: {where}{what}")
