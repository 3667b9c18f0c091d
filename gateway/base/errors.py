"""The error root of this package, and the format versions of its files.

Format versions of the files that the gateway writes and reads again: configuration, parameter store, dump, recording.

A version rises when an older gateway would read the file wrongly or not at all. Every gateway reads the files of all
releases from 0.9.0 on (tests/formats). A file of a newer version is rejected and stays as it is: a downgrade loses nothing.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from pdgw.base.errors import PdgwError


class GatewayError(PdgwError):
    """A fault of the gateway or its configuration, in one line that a user can act on."""


DAMAGED = (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError, struct.error)
"""What reading a damaged file can raise."""


@contextmanager
def reading(what: str) -> Iterator[None]:
    """Report what damaged data raises as a GatewayError. ``what``: the place."""
    try:
        yield
    except DAMAGED as error:
        raise GatewayError(f"{what}: damaged ({type(error).__name__}: {error})") from error


@contextmanager
def writing(what: object) -> Iterator[None]:
    """Report an OSError of a file as a GatewayError. ``what``: the file, with the option that names it."""
    try:
        yield
    except OSError as error:
        raise GatewayError(f"{what}: cannot be written ({error.strerror or error})") from error


def problem(version: int, newest: int) -> str:
    """Why a file of this version cannot be read; empty when it can."""
    if 1 <= version <= newest:
        return ""
    return (
        f"format version {version} is unknown, this gateway reads 1 to {newest}: use the gateway that wrote "
        "the file, or a newer one"
    )


def at_most(newest: int) -> Callable[[int], int]:
    """The same as a validator of pydantic."""

    def check(version: int) -> int:
        if text := problem(version, newest):
            raise ValueError(text)
        return version

    return check
