"""Single keys from a terminal, on POSIX and Windows; characters from a pipe."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator

_AT_ONCE = 64


@contextlib.contextmanager
def single_keys() -> Iterator[None]:
    """The terminal gives each key at once and does not print it; as before afterwards. Without a terminal nothing changes."""
    if not sys.stdin.isatty() or sys.platform == "win32":
        yield
        return
    import termios  # noqa: PLC0415 (not there on Windows)
    import tty  # noqa: PLC0415

    before = termios.tcgetattr(sys.stdin)
    try:
        tty.setcbreak(sys.stdin)
        yield
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)


def read_keys() -> str:
    """The next keys, waiting for one; empty at the end of the input."""
    if sys.platform == "win32" and sys.stdin.isatty():
        import msvcrt  # noqa: PLC0415 (there on Windows only)

        return msvcrt.getwch()
    # Past Python's own buffer, which waits for a whole block.
    return os.read(sys.stdin.fileno(), _AT_ONCE).decode("utf-8", "replace")
