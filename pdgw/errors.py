"""The base of all errors that the library raises. Every package may import it."""

from __future__ import annotations


class PdgwError(Exception):
    """What the library raises: GatewayError, CanopenError and ProfidriveError; one line that says what is wrong."""


class ValueNotAllowedError(PdgwError):
    """Names the field or object, the offending value and what would have been allowed."""

    def __init__(self, field: str, value: object, allowed: str) -> None:
        self.field = field
        self.value = value
        self.allowed = allowed
        super().__init__(f"{field}: {value!r} is not allowed, expected {allowed}")
