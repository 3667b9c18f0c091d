"""End a command in the foreground on signals."""

from __future__ import annotations

import signal
from typing import Final

INTERRUPTED: Final = 130
"""Exit code after Ctrl-C, as used by shells."""


def end_as_by_ctrl_c() -> None:
    """Handle SIGTERM and SIGHUP like Ctrl-C, so that open files are completed. A SIGHUP ignored by nohup stays ignored."""
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)  # Windows has only one of them
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler)
