"""Configuration of ``pdgw web``: address of the page, access rights, MQTT."""

from __future__ import annotations

import ipaddress
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, Field, Strict, model_validator

from pdgw.base.validation import misplaced
from pdgw.gateway.configuration.environment import Boolean, Integer, Section, in_words

WEB_PORT = 8420
"""TCP on loopback: the page, unless ``listen`` says otherwise."""
_HostName = Annotated[
    str,
    in_words(
        "[A-Za-z0-9]([A-Za-z0-9.-]{0,252}[A-Za-z0-9])?",
        "a host name without scheme and port: letters, digits, dots and hyphens, first and last a letter or digit",
    ),
]
_Topic = Annotated[
    str,
    in_words(r"[^/+#$\x00][^+#\x00]{0,199}", "1 to 200 characters without the wildcards + and #, the first not / or $"),
]


def split_address(text: str) -> tuple[str, int]:
    """``127.0.0.1:8420``, ``localhost:8420``, ``[::1]:8420`` or ``::1:8420`` as address and port; ValueError for another text."""
    host, _, port = text.rpartition(":")
    host = "127.0.0.1" if host.lower() == "localhost" else host
    host = host.removeprefix("[").removesuffix("]") if host.startswith("[") else host
    try:
        ipaddress.ip_address(host)
        number = int(port)
    except ValueError:
        number = -1
    if not 0 <= number <= 0xFFFF:
        raise ValueError(f'{text!r} is not an address with a port, expected for example "127.0.0.1:{WEB_PORT}"')
    return host, number


def _is_address(text: str) -> str:
    split_address(text)
    return text


def _is_host(text: str) -> str:
    try:
        text.encode("idna")  # as the MQTT client does, whose thread would end with the error
        is_name = 0 < len(text) <= 253 and not set(":/@ ") & set(text)
    except UnicodeError:
        is_name = False
    if not is_name:
        try:
            ipaddress.ip_address(text)
        except ValueError:
            raise ValueError(f"{text!r} is not a host name or address without scheme and port") from None
    return text


class WebConfig(Section):
    """The page. A client that reaches it can read everything and change nothing."""

    listen: Annotated[str, Strict(), AfterValidator(_is_address)] = f"127.0.0.1:{WEB_PORT}"
    token_file: Path | None = None
    """The file with the secret that opens the page; needed beyond loopback."""
    hosts: tuple[_HostName, ...] = ()
    """Names by which browsers reach it, beside its address: a page of another name is refused (DNS rebinding)."""
    tls_cert: Path | None = None
    """PEM file with the certificate and its key."""

    @property
    def address(self) -> tuple[str, int]:
        """The address that it listens on."""
        return split_address(self.listen)

    @property
    def is_local(self) -> bool:
        """Only programs on this machine reach it."""
        return ipaddress.ip_address(self.address[0]).is_loopback

    @model_validator(mode="after")
    def _is_guarded(self) -> WebConfig:
        address = ipaddress.ip_address(self.address[0])
        if not address.is_loopback and self.token_file is None:
            text = f"token_file is missing: other computers can reach listen = {self.listen}"
            raise misplaced(text, "listen")
        if address.is_unspecified and not self.hosts:
            text = (
                f"hosts is missing: a browser cannot open listen = {self.listen}; list the names of this "
                "machine in hosts"
            )
            raise misplaced(text, "listen")
        return self


class MqttConfig(Section):
    """The broker for the states of the axes; the gateway receives nothing from it."""

    host: Annotated[str, AfterValidator(_is_host)]
    port: Annotated[Integer, Field(ge=1, le=65535)] = 1883
    topic: _Topic = "pdgw"
    """Before the name of the gateway."""
    username: str | None = None
    password_file: Path | None = None
    tls: Boolean | Path = False
    """True: the system has the certificates that the broker's is checked with; or the file that has them."""

    @model_validator(mode="after")
    def _is_complete(self) -> MqttConfig:
        if self.password_file is not None and self.username is None:
            raise misplaced("password_file needs username", "password_file")
        return self
