"""Commands of ``pdgw`` in this process: what they print, and their exit status."""

from __future__ import annotations

import io
import sys
from contextlib import redirect_stderr, redirect_stdout
from subprocess import CompletedProcess
from unittest.mock import patch

from pdgw.tools.cli import main


def pdgw(*arguments: str, text: str | None = None) -> CompletedProcess[str]:
    """Run a command of ``pdgw`` to its end; ``text`` is its standard input."""
    output, errors = io.StringIO(), io.StringIO()
    status = 0
    with (
        patch.object(sys, "argv", ["pdgw", *arguments]),
        patch.object(sys, "stdin", io.StringIO(text or "")),
        redirect_stdout(output),
        redirect_stderr(errors),
    ):
        try:
            main()
        except SystemExit as end:
            status = end.code if isinstance(end.code, int) else int(end.code is not None)
    return CompletedProcess(["pdgw", *arguments], status, output.getvalue(), errors.getvalue())
