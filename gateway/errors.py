"""The one error root of this package."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from pdgw.errors import PdgwError


class GatewayError(PdgwError):
    """A fault of the gateway or its configuration, in one line that a user can act on."""


@contextmanager
def writing(what: object) -> Iterator[None]:
    """Report an OSError of a file as a GatewayError. ``what``: the file, with the option that names it."""
    try:
        yield
    except OSError as error:
        raise GatewayError(f"{what}: cannot be written ({error.strerror or error})") from error
