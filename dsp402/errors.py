"""The one error root of this package."""

from __future__ import annotations

from pdgw.ds301.errors import CanopenError


class Dsp402Error(CanopenError):
    """A drive fault or unusable drive data: names the field, the value and what would have been allowed."""
