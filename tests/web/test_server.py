"""The server of the page, its copy of the status, its parameters and libraries, and ``pdgw web``."""

from __future__ import annotations

import asyncio
import errno
import hashlib
import json
import os
import re
import socket
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

import pdgw.tools.web
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.configuration.web import WebConfig
from pdgw.tools.web.app import STATIC
from pdgw.tools.web.parameters import PageParameters
from pdgw.tools.web.server.server import CONNECTIONS_MAX, Places, made_server
from pdgw.tools.web.status.feed import Document, Feed
from pdgw.tools.web.stream import Streams
from pdgw.tools.web.support import VENDORED, RequestError
from tests.support import cli
from tests.support.gateways.daemon import axis, configuration, reached, serving


class Port(socket.socket):
    """Has no descriptor for a connection; ``asked`` how often in one turn of the loop."""

    def __init__(self) -> None:
        super().__init__(socket.AF_INET, socket.SOCK_STREAM)
        self.bind(("127.0.0.1", 0))
        self.tries = 0
        self.asked: asyncio.Future[int] = asyncio.get_running_loop().create_future()

    def listen(self, backlog: int = 0, /) -> None:
        super().listen(backlog)
        self.room = backlog

    def accept(self) -> Any:
        if not self.tries:
            asyncio.get_running_loop().call_soon(lambda: self.asked.set_result(self.tries))
        self.tries += 1
        raise OSError(errno.EMFILE, "Too many open files")


async def application(scope: Any, receive: Any, send: Any) -> None:
    while (await receive())["type"] == "lifespan.startup":
        await send({"type": "lifespan.startup.complete"})
    await send({"type": "lifespan.shutdown.complete"})


def test_failed_accept_is_retried_once_a_second() -> None:
    """asyncio tries to accept ``backlog`` connections at once, and repeats each failed try later."""

    async def run_clients() -> tuple[int, int]:
        with Port() as port, socket.socket() as visitor:
            server = made_server(application, cast(Streams, SimpleNamespace(close=list)), Places(), WebConfig())
            server.lifespan = server.config.lifespan_class(server.config)
            await server.startup(sockets=[port])
            visitor.setblocking(False)
            await asyncio.get_running_loop().sock_connect(visitor, port.getsockname())
            tries = await port.asked
            room = port.room
            await server.shutdown(sockets=[port])
            return tries, room

    assert asyncio.run(run_clients()) == (1, CONNECTIONS_MAX), "who waits to be taken has his place all the same"


@pytest.mark.parametrize(
    "error", [GatewayError("gone"), KeyError("axes"), ValueError("9e99"), RuntimeError("no thread")]
)
def test_unusable_answer_marks_data_old_and_polling_continues(error: Exception) -> None:
    answers: Iterator[Document | Exception] = iter(({"n": 1}, error, {"n": 3}))
    seen: list[tuple[int, bool]] = []

    async def ask() -> Document:
        answer = next(answers)
        if isinstance(answer, Exception):
            raise answer
        return answer

    async def took(document: Document) -> None:
        """Nothing to note."""

    async def run_clients() -> None:
        feed = Feed(ask, took)
        feed.watched_s = feed.unwatched_s = 0.0
        feed.listeners.append(lambda: seen.append(((feed.document or {})["n"], feed.stale)))
        asking = asyncio.create_task(feed.run())
        while len(seen) < 3 and not asking.done():
            await feed.next_tick(60.0)
        asking.cancel()

    asyncio.run(run_clients())
    assert seen[:3] == [(1, False), (1, True), (3, False)]


def test_failing_listener_is_logged_and_blocks_no_other(caplog: pytest.LogCaptureFixture) -> None:
    told: list[int] = []

    async def ask() -> Document:
        return {}

    async def took(document: Document) -> None:
        """Nothing to note."""

    def broken() -> None:
        raise ValueError("a mistake")

    async def run_clients() -> None:
        feed = Feed(ask, took)
        feed.listeners += [broken, lambda: told.append(feed.ticks)]
        await feed.once()
        await feed.once()

    asyncio.run(run_clients())
    assert told == [1, 2]
    assert "ValueError: a mistake" in caplog.text


FOLDER = VENDORED.parent


def test_every_vendored_file_is_the_one_that_was_listed() -> None:
    listed = {item["file"]: item["sha256"] for package in json.loads(VENDORED.read_text()) for item in package["files"]}
    there = {
        path.relative_to(FOLDER).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in FOLDER.rglob("*")
        if path.is_file() and path != VENDORED
    }
    assert there == listed


def test_every_vendored_package_has_version_and_licence() -> None:
    for package in json.loads(VENDORED.read_text()):
        assert re.fullmatch(r"\d+\.\d+\.\d+", package["version"])
        assert package["licence"] in {"BSD-3-Clause", "MIT"}
        assert any(item["from"] == "LICENSE" for item in package["files"])


def test_page_loads_nothing_from_others_and_has_no_inline_code() -> None:
    for path in STATIC.rglob("*"):
        if path.suffix not in {".html", ".js", ".css"} or FOLDER in path.parents:
            continue
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"https?://", text), path
        assert not re.search(r"\s(?:on[a-z]+|style)\s*=\s*[\"'$]", text), path
    assert "<script>" not in (STATIC / "index.html").read_text()


def test_elements_have_name_unit_and_meaning() -> None:
    with serving(configuration(axis(1))) as (daemon, client), reached(daemon):
        parameters = PageParameters(client.address)
        (telegram,) = parameters.read(1, "P922")
        assert (telegram["parameter"], telegram["name"], telegram["value"]) == ("P922", "Telegram", 1)
        (statusword,) = parameters.read(1, "6041h")
        assert statusword["meaning"].endswith("Switch On Disabled")
        vendor, product = parameters.read(1, "1018h.1-2")
        assert (vendor["parameter"], product["parameter"]) == ("1018h.1", "1018h.2")
        (missing,) = parameters.read(1, "P40")
        assert missing["error"] is not None
        assert missing["meaning"]
        names = {item["pnu"]: item["name"] for item in parameters.names(1)}
        assert names["P922"] == "Telegram"
        assert names["6041h"] == "Statusword"


def test_dump_can_be_restored() -> None:
    with serving(configuration(axis(1))) as (daemon, client), reached(daemon):
        document = PageParameters(client.address).dump(1)
    assert (document["version"], document["do_id"]) == (1, 1)
    assert any(item["pnu"] == 922 for item in document["parameters"])


def test_invalid_parameters_and_missing_channel_are_reported() -> None:
    with pytest.raises(RequestError, match="not understood, expected for example") as wrong:
        PageParameters(("127.0.0.1", 9)).read(1, "speed")
    assert (wrong.value.status, wrong.value.field) == (400, "pnu")
    with pytest.raises(GatewayError, match="only the controller can read parameters"):
        PageParameters(None).read(1, "P922")


CONFIG = '[can]\ninterface = "virtual"\n[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = 1\n'


@pytest.fixture(autouse=True)
def _keeps_its_priority(monkeypatch: pytest.MonkeyPatch) -> None:
    """The process of the tests keeps its priority."""
    monkeypatch.setattr(os, "nice", lambda _: 0)


@pytest.mark.parametrize(
    ("package", "extra", "more"),
    [("starlette", "web", ""), ("prometheus_client", "web", ""), ("paho", "mqtt", '[mqtt]\nhost = "b"\n')],
)
def test_web_without_its_packages_names_the_extra(
    package: str, extra: str, more: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [
        name for name in sys.modules if name.partition(".")[0] == package or name.startswith("pdgw.tools.web.")
    ]:
        monkeypatch.delitem(sys.modules, name)
        monkeypatch.delattr(pdgw.tools.web, name.removeprefix("pdgw.tools.web."), raising=False)
    monkeypatch.setitem(sys.modules, package, None)
    config = tmp_path / "gateway.toml"
    config.write_text(CONFIG + more)
    done = cli.pdgw("web", str(config), "--log-file", str(tmp_path / "log"), "--listen", "127.0.0.1:0")
    assert done.returncode == 1
    assert f"this needs {package}: pip install 'profidrive-gateway[{extra}]'" in " ".join(done.stderr.split())


@pytest.mark.parametrize(
    ("lines", "part"),
    [
        ("[transport]\nstatus_port = 0\n", "needs the status port"),
        ('[web]\ntoken_file = "none"\n', "token_file"),
        ('[web]\ntls_cert = "none"\n', "tls_cert"),
    ],
)
def test_start_errors_of_the_page_are_one_line(tmp_path: Path, lines: str, part: str) -> None:
    config = tmp_path / "gateway.toml"
    config.write_text(f'{lines}[can]\ninterface = "virtual"\n[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = 1\n')
    done = cli.pdgw("web", str(config), "--log-file", str(tmp_path / "log"), "--listen", "127.0.0.1:0")
    assert done.returncode == 1
    assert part in done.stderr
    assert "Traceback" not in done.stderr


def test_used_port_and_address_without_a_token_are_reported(tmp_path: Path) -> None:
    config = tmp_path / "gateway.toml"
    config.write_text('[can]\ninterface = "virtual"\n[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = 1\n')
    with socket.create_server(("127.0.0.1", 0)) as taken:
        done = cli.pdgw(
            "web", str(config), "--log-file", str(tmp_path / "log"), "--listen", f"127.0.0.1:{taken.getsockname()[1]}"
        )
    assert (done.returncode, "cannot be used" in done.stderr) == (1, True)
    done = cli.pdgw("web", str(config), "--log-file", str(tmp_path / "log"), "--listen", "10.1.2.3:8420")
    assert (done.returncode, "token_file is missing" in done.stderr) == (1, True)
