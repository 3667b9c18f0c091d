"""Read the gateways of an Ansible inventory and query the status of each from its page.

Gateways are the hosts of the group ``gateways`` and of the groups below it. Variables of a host override those of its
groups. Relative paths start in the folder of the inventory.
Source: https://docs.ansible.com/ansible/latest/inventory_guide/intro_inventory.html (YAML format).
"""

from __future__ import annotations

import http.client
import json
import ssl
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final, NamedTuple

import yaml

from pdgw.gateway.errors import GatewayError

GROUP: Final = "gateways"
PATIENCE_S: Final = 5.0
"""Time for a gateway to answer, from the connection to the last byte."""
_AT_A_TIME: Final = 64
_LONGEST: Final = 4 << 20
"""Size limit of a status document in bytes."""
_PORT: Final = 8420
_SERVICE_UNAVAILABLE: Final = 503


class Place(NamedTuple):
    """Address of a gateway's page."""

    name: str
    host: str
    port: int = _PORT
    tls: bool = False
    ca: str = ""
    """File with trusted certificates; empty: those of the system."""
    token_file: str = ""


class Answer(NamedTuple):
    """The status document of a gateway, or why there is none."""

    name: str
    document: dict[str, Any] | None
    error: str = ""


def places(inventory: Path) -> list[Place]:
    """The gateways of an inventory by name. GatewayError when it cannot be read or has none."""
    try:
        document = yaml.safe_load(inventory.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise GatewayError(f"{inventory}: cannot be read ({error})") from error
    try:
        found = dict(_hosts(document or {}))
        made = [_place(name, variables, inventory.parent) for name, variables in sorted(found.items())]
    except (AttributeError, TypeError, ValueError, RecursionError) as error:
        raise GatewayError(f"{inventory}: not an Ansible inventory in YAML ({error})") from error
    if not made:
        raise GatewayError(f"{inventory}: the group {GROUP} has no host, expected at least one")
    return made


def ask_all(gateways: Sequence[Place]) -> list[Answer]:
    """Query all gateways, 64 at a time. The answers have the order of the gateways."""
    with ThreadPoolExecutor(_AT_A_TIME) as pool:
        return list(pool.map(ask, gateways))


def ask(place: Place) -> Answer:
    """Query one gateway. Every failure is a text in the answer."""
    try:
        return Answer(place.name, _get(place))
    except (OSError, http.client.HTTPException, ValueError) as error:
        return Answer(place.name, None, str(error) or type(error).__name__)


def _hosts(groups: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Name and variables of each host in ``GROUP``, at any depth."""
    found: dict[str, dict[str, Any]] = {}

    def walk(name: str, group: Mapping[str, Any] | None, inherited: dict[str, Any], inside: bool) -> None:
        body = group or groups.get(name) or {}
        variables = inherited | (body.get("vars") or {})
        member = inside or name == GROUP
        for host, own in (body.get("hosts") or {}).items():
            if member:
                found[str(host)] = found.get(str(host), {}) | variables | (own or {})
        for below, content in (body.get("children") or {}).items():
            walk(below, content, variables, member)

    for name, group in groups.items():
        walk(name, group, {}, inside=False)
    yield from found.items()


def _place(name: str, variables: Mapping[str, Any], folder: Path) -> Place:
    port = int(variables.get("pdgw_page_port", _PORT))
    if not 0 < port <= 0xFFFF:
        raise ValueError(f"{name}: pdgw_page_port {port}, expected 1 to 65535")
    tls = variables.get("pdgw_tls", False)
    if not isinstance(tls, bool):
        raise TypeError(f"{name}: pdgw_tls {tls!r}, expected true or false")
    named = (variables.get(key) for key in ("pdgw_ca", "pdgw_token_file"))
    files = (str(folder / str(file)) if file else "" for file in named)
    return Place(name, str(variables.get("ansible_host", name)), port, tls, *files)


def _get(place: Place) -> dict[str, Any]:
    end = time.monotonic() + PATIENCE_S
    headers = {"Accept": "application/json"}
    if place.token_file:
        headers["Authorization"] = f"Bearer {Path(place.token_file).read_text(encoding='ascii').strip()}"
    if place.tls:
        context = ssl.create_default_context(cafile=place.ca or None)
        connection: http.client.HTTPConnection = http.client.HTTPSConnection(
            place.host, place.port, timeout=PATIENCE_S, context=context
        )
    else:
        connection = http.client.HTTPConnection(place.host, place.port, timeout=PATIENCE_S)
    try:
        connection.request("GET", "/api/v1/status", headers=headers)
        response = connection.getresponse()
        body = bytearray()
        while chunk := response.read1(1 << 16):
            body += chunk
            if len(body) > _LONGEST or time.monotonic() > end:
                raise ValueError(f"the answer is longer than {_LONGEST} bytes or takes longer than {PATIENCE_S:g} s")
    finally:
        connection.close()
    if response.status == _SERVICE_UNAVAILABLE:
        raise ValueError("the page runs, but its gateway does not answer")
    if response.status != http.client.OK:
        raise ValueError(f"HTTP status {response.status} {response.reason}")
    document = json.loads(body)
    if not isinstance(document, dict):
        raise ValueError("the answer is not a status document")
    return document
