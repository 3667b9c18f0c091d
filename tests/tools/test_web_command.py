"""``pdgw web``: start errors are one line, also missing packages."""

from __future__ import annotations

import os
import socket
import sys
from pathlib import Path

import pytest

import pdgw.tools.web
from tests.support import cli

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
