"""The base of all errors that the library raises. Every package may import it."""

from __future__ import annotations


class PdgwError(Exception):
    """Base of the errors of the library: GatewayError, CanopenError and ProfidriveError. The text is one line."""


class ValueNotAllowedError(PdgwError):
    """Names field or object, the offending value and what would have been allowed. ``remedy``: what to do, where that is more."""

    def __init__(self, field: str, value: object, allowed: str, remedy: str = "") -> None:
        self.field = field
        self.value = value
        self.allowed = allowed
        self.remedy = remedy
        self.evidence = f"{field}: {value!r} is not allowed, expected {allowed}"
        super().__init__(self.evidence + (remedy and f"; {remedy}"))
