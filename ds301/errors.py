"""The one error root of this package."""

from __future__ import annotations


class CanopenError(Exception):
    """A CANopen fault: names the field or object, the offending value and what would have been allowed."""

    def __init__(self, field: str, value: object, allowed: str) -> None:
        self.field = field
        self.value = value
        self.allowed = allowed
        super().__init__(f"{field}: {value!r} is not allowed, expected {allowed}")
