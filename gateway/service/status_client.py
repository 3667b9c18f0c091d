"""Client of the status port of a running daemon. Server: ``gateway.service.status_port``; document: docs/operation.md."""

from __future__ import annotations

import json
import socket
import time
from typing import Any

from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.service.last_words import last_words

_PATIENCE_S = 5.0
_LEAST_S = 0.001
"""A time limit of 0 would be none."""
_LONGEST = 16 << 20
"""Bytes of an answer; that of 32 axes has some hundred thousand."""


def fetch(port: int, patience_s: float = _PATIENCE_S) -> dict[str, Any]:
    """The status document of the daemon on a loopback port; GatewayError when none answers within about ``patience_s``."""
    document = _ask(port, "", patience_s)
    if not {"schema", "plc", "axes", "encoders"} <= document.keys():
        raise _no_gateway(port)
    return document


def fetch_events(port: int, number: int, patience_s: float = _PATIENCE_S) -> list[dict[str, Any]]:
    """The events after this number that the daemon keeps, the oldest first."""
    return _fetch_list(port, ("events", str(number)), "events", patience_s)


def fetch_faults(port: int, do_id: int, patience_s: float = _PATIENCE_S) -> list[dict[str, Any]]:
    """All faults and warnings of a drive object that the daemon keeps, newest first; GatewayError when there is no such one."""
    return _fetch_list(port, ("faults", str(do_id)), "faults", patience_s)


def fetch_explanation(port: int, do_id: int | None, patience_s: float = _PATIENCE_S) -> list[dict[str, Any]]:
    """The lines around the last fault or stop, of one drive object or (None) of all; GatewayError when there is no such one."""
    return _fetch_list(port, ("explain", "" if do_id is None else str(do_id)), "lines", patience_s)


def _fetch_list(port: int, request: tuple[str, str], key: str, patience_s: float) -> list[dict[str, Any]]:
    document = _ask(port, " ".join(request), patience_s)
    if "error" in document:
        raise GatewayError(f"{document.get('field')} {request[1]}: {document['error']}")
    found = document.get(key)
    if not isinstance(found, list):
        raise _no_gateway(port)
    return found


def _ask(port: int, request: str, patience_s: float) -> dict[str, Any]:
    end = time.monotonic() + patience_s
    try:
        with socket.create_connection(("127.0.0.1", port), timeout=patience_s) as connection:
            connection.sendall(f"{request}\n".encode())
            text = b""
            while len(text) <= _LONGEST and (part := connection.recv(65536)):
                text += part
                connection.settimeout(max(_LEAST_S, end - time.monotonic()))
    except OSError as error:
        silent = f"no gateway answers on 127.0.0.1 port {port} ({error.strerror or error})"
        raise GatewayError("; ".join(filter(None, (silent, last_words(port))))) from error
    try:
        document = json.loads(text)
    except ValueError as error:
        raise _no_gateway(port) from error
    if not isinstance(document, dict):
        raise _no_gateway(port)
    return document


def _no_gateway(port: int) -> GatewayError:
    return GatewayError(f"127.0.0.1 port {port}: the answer does not come from a gateway")
