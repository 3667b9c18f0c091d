"""The base of all errors that the library raises. Every package may import it."""

from __future__ import annotations


class PdgwError(Exception):
    """Base of the errors of the library: GatewayError, CanopenError and ProfidriveError. The text is one line."""


class ValueNotAllowedError(PdgwError):
    """Names the field or object, the offending value and what would have been allowed."""

    def __init__(self, field: str, value: object, allowed: str) -> None:
        self.field = field
        self.value = value
        self.allowed = allowed
        super().__init__(f"{field}: {value!r} is not allowed, expected {allowed}")
