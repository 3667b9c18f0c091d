"""Read single keys from a terminal, on POSIX and Windows, or characters from a pipe."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator

_AT_ONCE = 64


@contextlib.contextmanager
def single_keys() -> Iterator[None]:
    """Set the terminal to deliver each key at once and without echo; restore it afterwards. No effect without a terminal."""
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
    """Wait for the next keys and return them; empty at the end of the input."""
    if sys.platform == "win32" and sys.stdin.isatty():
        import msvcrt  # noqa: PLC0415 (there on Windows only)

        return msvcrt.getwch()
    # Read past Python's buffer, which waits for a whole block.
    return os.read(sys.stdin.fileno(), _AT_ONCE).decode("utf-8", "replace")
