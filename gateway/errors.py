"""The one error root of this package."""

from __future__ import annotations

from pdgw.errors import PdgwError


class GatewayError(PdgwError):
    """A fault of the gateway or its configuration, in one line that a user can act on."""
