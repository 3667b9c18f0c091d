"""How a command in the foreground is ended from outside."""

from __future__ import annotations

import signal
from typing import Final

INTERRUPTED: Final = 130
"""The exit code of what was ended by Ctrl-C, as shells have it."""


def end_as_by_ctrl_c() -> None:
    """SIGTERM, and the end of the terminal where that is not ignored (nohup): what is open is finished, as after Ctrl-C."""
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)  # Windows has one of them
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler)
