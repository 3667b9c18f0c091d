"""The web site (``make site``): its search finds faults, bits and objects; nothing loads from another host."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FOUND = {
    "F 125": "tables/fault-numbers-of-the-gateway-p947.html",
    "ZSW1.8": "tables/signals.html#zsw1",
    "1017h": "devices.html#heartbeats",
    "habits": "habits.html",
}
"""A query, and a place among its first answers."""


@pytest.mark.e2e
@pytest.mark.skipif(find_spec("material") is None, reason="mkdocs-material is not installed: pip install -e '.[site]'")
@pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")
def test_search_of_the_site_finds_faults_bits_and_objects(tmp_path: Path) -> None:
    build = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path)]
    subprocess.run(build, check=True, cwd=ROOT)
    search = ["node", str(Path(__file__).with_name("site_search.mjs")), str(tmp_path), *FOUND]
    answers = json.loads(subprocess.run(search, check=True, capture_output=True, text=True).stdout)
    missing = [
        query for query, place in FOUND.items() if not any(item.startswith(place) for item in answers[query][:20])
    ]
    assert missing == []
    loaded = re.compile(r"""<(?:script|img|iframe|link rel="stylesheet")[^>]* (?:src|href)="(https?://[^"]+)""")
    pages = {path.name: loaded.findall(path.read_text("utf-8")) for path in tmp_path.rglob("*.html")}
    assert {name: hosts for name, hosts in pages.items() if hosts} == {}
