"""The one error root of this package."""

from __future__ import annotations

from pdgw.base.errors import ValueNotAllowedError


class ProfidriveError(ValueNotAllowedError, ValueError):
    """Bad PROFIdrive data: names the field, the offending value and what would have been allowed."""
