"""The README's tour and the tutorials, word by word: every command is typed, what it prints is what the document shows. Of the
other documents the commands are typed in ``other-documents.md``.

``make tour`` runs them (not among the quick tests: each command is a process of its own).
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.tour.console import Command, File, agrees, steps

ROOT = Path(__file__).parents[2]
DOCUMENTS = [
    *(
        path
        for path in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
        if "```console" in path.read_text()
    ),
    Path(__file__).with_name("other-documents.md"),
]


def test_the_blocks_of_a_document_are_commands_and_files() -> None:
    document = (
        "```toml\n# a.toml\nx = 1\n```\n"
        "   ```console\n   $ echo one   # a remark\n   o...e\n   $ sleep 9 &\n   ```\n"
        "```toml\ny = 2\n```\n"
    )
    assert list(steps(document)) == [
        File("a.toml", "# a.toml\nx = 1\n"),
        Command("echo one", "o...e\n"),
        Command("sleep 9 &", ""),
    ]
    assert agrees("a ... c\n", "a  b\n c\n")
    assert not agrees("a\n", "a\nb\n")


@pytest.mark.e2e
@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_a_reader_sees_what_the_document_shows(document: Path, tmp_path: Path) -> None:
    if not all(shutil.which(tool) for tool in ("unshare", "ip")):
        pytest.skip("unshare and ip (util-linux, iproute2) are needed for a network of its own")
    private = ["unshare", "-Urn"]
    if subprocess.run([*private, "true"], check=False, capture_output=True).returncode:
        pytest.skip("this kernel forbids user namespaces")
    home = {"HOME": str(tmp_path), "XDG_STATE_HOME": str(tmp_path / "state"), "XDG_RUNTIME_DIR": str(tmp_path / "run")}
    (tmp_path / "run").mkdir()
    done = subprocess.run(
        [*private, sys.executable, "-m", "tests.tour.console", str(document), str(tmp_path)],
        check=False,
        cwd=ROOT,
        env=os.environ | home | {"COLUMNS": "120"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr + done.stdout
