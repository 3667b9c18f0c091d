"""Order in which another processor sees stores to shared memory, and how Python code controls it.

x86 keeps the order of stores and of loads. ARM, RISC-V and POWER do not. Python has no memory barrier, but its locks are
barriers: stores before a release are visible before it, loads after an acquire happen after it, and a release is before the next
acquire.
"""

from __future__ import annotations

import platform
import threading
from typing import Final

IN_ORDER: Final = platform.machine().lower() in {"x86_64", "amd64", "i386", "i486", "i586", "i686", "x86"}
"""Other processors of this machine see stores in their order."""


class Fence:
    """Each call separates earlier stores and loads from later ones. For one thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._lock.acquire()

    def __call__(self) -> None:
        self._lock.release()
        self._lock.acquire()
