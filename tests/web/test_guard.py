"""Who may ask: hosts, methods, other sites, the token and how often it may be wrong."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from starlette.datastructures import Headers
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.configuration.file import load_config, parse_config
from pdgw.gateway.configuration.web import WebConfig
from pdgw.tools.web.server.guard import (
    COOKIE,
    FAILURES_MAX,
    FAILURES_WITHIN_S,
    LOGIN_PATH,
    Guard,
    Token,
    allowed_hosts,
    read_token,
)
from pdgw.tools.web.server.server import Places
from tests.support.gateways.daemon import axis
from tests.support.page import TOKEN

API = "/api/v1/status"
MINIMUM = '[can]\ninterface = "virtual"\n' + axis(1)


async def nothing(scope: Scope, receive: Receive, send: Send) -> None:
    raise AssertionError("asked")


class Asked:
    """A guard with a clock the test moves."""

    def __init__(self, token: str | None = None, *, secure: bool = False, **web: object) -> None:
        self.now = 0.0
        config = WebConfig.model_validate({"listen": "127.0.0.1:8420", **web})
        made = None if token is None else Token(token)
        self.guard = Guard(nothing, allowed_hosts(config), made, Places(), lambda: self.now, secure=secure)

    def __call__(self, path: str = API, method: str = "GET", address: str = "a", **headers: str) -> Response | None:
        given = {"host": "127.0.0.1:8420"} | {name.replace("_", "-"): value for name, value in headers.items()}
        return self.guard.answer(method, path, Headers(given), address)

    def status(self, *arguments: str, **headers: str) -> int:
        answer = self(*arguments, **headers)
        return 200 if answer is None else answer.status_code


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS", "TRACE"])
@pytest.mark.parametrize("path", ["/", API, LOGIN_PATH, "/metrics"])
def test_only_read_requests_are_allowed(method: str, path: str) -> None:
    answer = Asked()(path, method)
    assert answer is not None
    assert answer.status_code == 405
    assert answer.headers["allow"] == "GET, HEAD"


@pytest.mark.parametrize("host", ["127.0.0.1:8420", "localhost:8420", "LOCALHOST", "[::1]:8420", "gateway.plant:80"])
def test_names_of_the_page_are_accepted(host: str) -> None:
    assert Asked(hosts=["Gateway.Plant"]).status(host=host) == 200


@pytest.mark.parametrize("host", ["evil.example", "evil.example:8420", "127.0.0.1.evil.example", "", "10.0.0.9:8420"])
def test_foreign_host_name_is_rejected_against_dns_rebinding(host: str) -> None:
    assert Asked().status(host=host) == 421


def test_an_address_of_the_plant_is_not_a_loopback_name() -> None:
    asked = Asked(TOKEN, listen="10.0.0.5:8420", token_file="t")
    assert asked.status("/", host="10.0.0.5:8420") == 200
    assert asked.status("/", host="localhost:8420") == 421


@pytest.mark.parametrize(
    ("site", "status"), [("none", 200), ("same-origin", 200), ("same-site", 403), ("cross-site", 403)]
)
def test_scripts_of_other_sites_get_no_data_but_a_link_opens_the_page(site: str, status: int) -> None:
    assert Asked().status(sec_fetch_site=site) == status
    assert Asked().status("/", sec_fetch_site=site) == 200


def test_without_the_token_there_is_the_empty_page_and_nothing_else() -> None:
    asked = Asked(TOKEN)
    assert [asked.status(path) for path in ("/", "/static/app.js", "/healthz", "/readyz")] == [200] * 4
    for path in (API, "/api/v1/events", "/metrics", LOGIN_PATH):
        answer = asked(path)
        assert answer is not None
        assert (answer.status_code, answer.headers["www-authenticate"]) == (401, "Bearer")


def test_the_token_opens_as_header_and_as_the_cookie_it_is_exchanged_for() -> None:
    asked = Asked(TOKEN)
    assert asked.status(authorization=f"Bearer {TOKEN}") == 200
    answer = asked(LOGIN_PATH, authorization=f"Bearer {TOKEN}")
    assert answer is not None
    assert answer.status_code == 204
    cookie = answer.headers["set-cookie"]
    assert TOKEN not in cookie
    assert {"HttpOnly", "SameSite=strict", "Path=/"} <= set(cookie.split("; "))
    assert "Secure" not in cookie
    pair = cookie.partition(";")[0]
    assert asked.status(cookie=f"other=1; {pair}") == 200
    assert asked.status(cookie=f"{COOKIE}=0{pair.partition('=')[2][1:]}x") == 401
    assert Asked("another token of enough characters").status(cookie=pair) == 401, "a new token ends all sessions"


def test_changed_token_file_ends_all_sessions(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    file = tmp_path / "token"
    file.write_text(TOKEN)
    token = Token.of(file)
    cookie = Headers({"cookie": f"{COOKIE}={token.session}"})
    assert not token.refresh()
    assert token.shown(cookie)
    file.write_text("another token of enough characters")
    assert token.refresh()
    assert not token.shown(cookie)
    assert token.opens("Bearer another token of enough characters")
    file.write_text("short")
    assert token.refresh()
    assert not token.opens("Bearer another token of enough characters")
    assert not token.opens("Bearer short")
    assert "expected 16 to 4096 printable ASCII characters" in caplog.text
    file.unlink()
    assert token.refresh()
    file.write_text(TOKEN)
    assert token.refresh()
    assert token.shown(cookie)


def test_the_cookie_of_an_encrypted_page_stays_on_encrypted_pages() -> None:
    answer = Asked(TOKEN, secure=True)(LOGIN_PATH, authorization=f"Bearer {TOKEN}")
    assert answer is not None
    assert "Secure" in answer.headers["set-cookie"]


@pytest.mark.parametrize("given", ["Bearer wrong", f"Basic {TOKEN}", "Bearer", f"Bearer {TOKEN}x", "\xff\xfe"])
def test_a_wrong_token_is_refused(given: str) -> None:
    assert Asked(TOKEN).status(authorization=given) == 401


def test_after_five_wrong_tokens_the_next_wrong_one_waits_for_a_minute() -> None:
    asked = Asked(TOKEN)
    for _ in range(FAILURES_MAX):
        assert asked.status(authorization="Bearer wrong") == 401
        asked.now += 1
    answer = asked(authorization="Bearer wrong")
    assert answer is not None
    assert answer.status_code == 429
    assert int(answer.headers["retry-after"]) == FAILURES_WITHIN_S - FAILURES_MAX + 1
    assert asked.status(API, "GET", "another", authorization="Bearer wrong") == 401
    asked.now = FAILURES_WITHIN_S
    assert asked.status(authorization="Bearer wrong") == 401


def test_wrong_tokens_do_not_lock_the_right_one_out() -> None:
    """Other clients may have the same address, for example with a proxy."""
    asked = Asked(TOKEN)
    for _ in range(2 * FAILURES_MAX):
        asked.status(authorization="Bearer wrong")
    assert asked.status(authorization="Bearer wrong") == 429
    assert asked.status(authorization=f"Bearer {TOKEN}") == 200
    assert asked.status(LOGIN_PATH, authorization=f"Bearer {TOKEN}") == 204


def test_errors_have_text_and_field() -> None:
    answer = Asked()(host="evil")
    assert answer is not None
    assert json.loads(bytes(answer.body)) == {
        "error": "not a name of this page; allowed: 127.0.0.1, [::1], localhost; add names with [web] hosts",
        "field": "host",
    }


# -- the configuration ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ('listen = "10.0.0.5:8420"', "token_file is missing"),
        ('listen = "0.0.0.0:8420"\ntoken_file = "t"', "hosts is missing"),
        ('listen = "[::]:8420"\ntoken_file = "t"', "hosts is missing"),
        ('listen = "gateway:8420"', "not an address with a port"),
        ('listen = "127.0.0.1"', "not an address with a port"),
        ('listen = "127.0.0.1:70000"', "not an address with a port"),
        ('hosts = ["a b"]', "hosts"),
        ("control = true", "unknown key"),
    ],
)
def test_a_page_that_is_open_to_others_or_unclear_is_refused(text: str, part: str) -> None:
    with pytest.raises(GatewayError, match=part):
        parse_config(MINIMUM + f"[web]\n{text}\n")


@pytest.mark.parametrize(
    ("listen", "address"),
    [
        ("::1:8425", ("::1", 8425)),
        ("[::1]:8425", ("::1", 8425)),
        ("localhost:8424", ("127.0.0.1", 8424)),
        ("Localhost:8424", ("127.0.0.1", 8424)),
    ],
)
def test_an_address_of_this_machine_needs_no_token(listen: str, address: tuple[str, int]) -> None:
    config = WebConfig(listen=listen)
    assert (config.address, config.is_local) == (address, True)
    assert "localhost" in allowed_hosts(config)


def test_page_files_are_relative_to_the_configuration(tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    file.write_text(
        MINIMUM + '[web]\ntoken_file = "web.token"\n[mqtt]\nhost = "b"\nusername = "u"\npassword_file = "p"\n'
    )
    config = load_config(file)
    assert config.web.token_file == tmp_path / "web.token"
    assert config.mqtt is not None
    assert config.mqtt.password_file == tmp_path / "p"


@pytest.mark.parametrize(
    "text", ["", "short", "x" * 5000, "sixteen chars but\nwith a line break", "ümlauts are no tokens"]
)
def test_a_token_file_holds_one_long_line(tmp_path: Path, text: str) -> None:
    file = tmp_path / "token"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(GatewayError, match="token_file"):
        read_token(file)
    file.write_text(f"\n  {TOKEN}  \n")
    assert read_token(file) == TOKEN


def test_missing_token_file_is_reported(tmp_path: Path) -> None:
    with pytest.raises(GatewayError, match="cannot be read"):
        read_token(tmp_path / "none")


@pytest.mark.parametrize("host", ["a..b", "x" * 64 + ".example"])
def test_unresolvable_broker_name_is_rejected_at_the_start(host: str) -> None:
    with pytest.raises(GatewayError, match=r"host.*is not a host name or address"):
        parse_config(f'{MINIMUM}[mqtt]\nhost = "{host}"\n')
