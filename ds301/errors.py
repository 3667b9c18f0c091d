"""The one error root of this package."""

from __future__ import annotations

from pdgw.errors import ValueNotAllowedError


class CanopenError(ValueNotAllowedError):
    """A CANopen fault: names the field or object, the offending value and what would have been allowed."""
