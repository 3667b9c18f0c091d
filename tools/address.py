"""Parse addresses typed by the user."""

from __future__ import annotations

import socket

from pdgw.gateway.errors import GatewayError


def parse_address(text: str, default_port: int) -> tuple[str, int]:
    """Split ``HOST`` or ``HOST:PORT``; raises GatewayError for any other text."""
    host, _, port = text.partition(":")
    if not host or (port and not (port.isdecimal() and len(port) < 6 and 0 < int(port) < 65536)):
        raise GatewayError(f"address {text!r}: expected HOST or HOST:PORT")
    try:
        return socket.gethostbyname(host), int(port) if port else default_port
    except OSError as error:
        raise GatewayError(f"address {text!r}: {error.strerror}") from error
    except UnicodeError as error:
        raise GatewayError(f"address {text!r}: not a host name: {error}") from error
