"""The one error root of this package."""

from __future__ import annotations

from pdgw.ds301.errors import CanopenError


class Dsp406Error(CanopenError):
    """An encoder fault or unusable encoder data: names the field, the value and what would have been allowed."""
