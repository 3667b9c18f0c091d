"""In which order another processor sees what was stored in shared memory, and how Python code has a say in it.

x86 shows stores in their order, and loads are made in theirs. ARM, RISC-V and POWER promise neither. Python has no barrier of
its own, but its locks have: what was before a release is before it for everybody, what is behind an acquire is behind it, and
a release is before the acquire that follows it.
"""

from __future__ import annotations

import platform
import threading
from typing import Final

IN_ORDER: Final = platform.machine().lower() in {"x86_64", "amd64", "i386", "i486", "i586", "i686", "x86"}
"""Other processors of this machine see stores in their order."""


class Fence:
    """Calls separate what is stored or loaded before from what is after. Of one thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._lock.acquire()

    def __call__(self) -> None:
        self._lock.release()
        self._lock.acquire()
