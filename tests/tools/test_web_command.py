"""``pdgw web`` where its packages are missing."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.e2e
CONFIG = '[can]\ninterface = "virtual"\n[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = 1\n'
_WITHOUT = """
import sys
sys.modules[sys.argv[1]] = None
sys.argv[:2] = ["pdgw"]
from pdgw.tools.cli import main
main()
"""


@pytest.mark.parametrize(
    ("package", "extra", "more"),
    [("starlette", "web", ""), ("prometheus_client", "web", ""), ("paho", "mqtt", '[mqtt]\nhost = "b"\n')],
)
def test_without_its_packages_the_command_says_what_to_install(
    package: str, extra: str, more: str, tmp_path: Path
) -> None:
    config = tmp_path / "gateway.toml"
    config.write_text(CONFIG + more)
    command = [sys.executable, "-c", _WITHOUT, package, "web", str(config), "--listen", "127.0.0.1:0"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 1
    assert f"this needs {package}: pip install 'profidrive-gateway[{extra}]'" in " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr
