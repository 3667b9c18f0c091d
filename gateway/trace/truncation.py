"""Keep the process alive when another program truncates a file that it has mapped.

A store beyond the end of a mapped file is SIGBUS, which would end the process without a stop sequence. A file in a run directory
cannot be sealed against it. So the signal handler puts anonymous memory in the place of the file, and the processor repeats the
store. The handler runs inside one store to the ring and uses nothing that this store leaves unfinished.
"""

from __future__ import annotations

import ctypes
import mmap
import signal
import sys
from typing import Any

_MAP_FIXED = 0x10
_FAILED = ctypes.c_void_p(-1).value
AVAILABLE = sys.platform == "linux"


class _Action(ctypes.Structure):
    """``struct sigaction`` of the C libraries of Linux (glibc and musl, on x86 and ARM)."""

    _fields_ = (
        ("handler", ctypes.c_void_p),
        ("mask", ctypes.c_ubyte * 128),
        ("flags", ctypes.c_int),
        ("restorer", ctypes.c_void_p),
    )


class _Info(ctypes.Structure):
    """The begin of ``siginfo_t``: number, error, code, then the address of the fault."""

    _fields_ = (("numbers", ctypes.c_int * 3), ("address", ctypes.c_void_p))


_SA_SIGINFO = 4
_Handler = ctypes.CFUNCTYPE(None, ctypes.c_int, ctypes.POINTER(_Info), ctypes.c_void_p)


class Mapping:
    """The address range of a writable map; ``truncated`` once its file became shorter. ``release`` before the map is closed."""

    def __init__(self, mapped: mmap.mmap) -> None:
        self.truncated = False
        self._size = len(mapped)
        self._begin = ctypes.addressof(ctypes.c_char.from_buffer(mapped))
        if AVAILABLE:
            _install()
            _mappings.append(self)

    def release(self) -> None:
        """The range is not ours any more."""
        if self in _mappings:
            _mappings.remove(self)

    def replaced_at(self, address: int) -> bool:
        """Put memory in the place of the file if the address is in this range."""
        if not self._begin <= address < self._begin + self._size:
            return False
        flags = mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | _MAP_FIXED
        access = mmap.PROT_READ | mmap.PROT_WRITE
        self.truncated = True
        return bool(_libc.mmap(self._begin, self._size, access, flags, -1, 0) != _FAILED)


_mappings: list[Mapping] = []
_previous = _Action()
_libc: Any = None


def _on_bus_error(number: int, info: Any, _context: int | None) -> None:
    address = info.contents.address or 0
    if not any(mapping.replaced_at(address) for mapping in _mappings):
        _libc.sigaction(
            number, ctypes.byref(_previous), None
        )  # not in our memory: the repeated access ends the process as before


_handler = _Handler(_on_bus_error)


def _install() -> None:
    global _libc  # noqa: PLW0603
    if _libc is not None:
        return
    _libc = ctypes.PyDLL(None)  # holds the interpreter's lock during its calls
    _libc.mmap.restype = ctypes.c_void_p
    _libc.mmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t, *[ctypes.c_int] * 3, ctypes.c_long]
    action = _Action(handler=ctypes.cast(_handler, ctypes.c_void_p).value, flags=_SA_SIGINFO)
    _libc.sigaction(int(signal.SIGBUS), ctypes.byref(action), ctypes.byref(_previous))
