"""Files of other projects are what their packages have, unchanged, and all of them are listed with version and licence."""

from __future__ import annotations

import hashlib
import json
import re

from pdgw.tools.web.app import STATIC
from pdgw.tools.web.support import VENDORED

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
