"""Errors of a request: answered with 400 or 404 and the name of the field."""

from __future__ import annotations

from pdgw.gateway.errors import GatewayError


class RequestError(GatewayError):
    """The request is wrong in ``field``: a path parameter, a parameter of the query, or a header."""

    def __init__(self, field: str, text: str, status: int = 400) -> None:
        super().__init__(text)
        self.field = field
        self.status = status
