"""Read a file that a user names. Every package may import it."""

from __future__ import annotations

import errno
import stat
from pathlib import Path


def read_file(path: Path, limit: int) -> bytes:
    """The content of a regular file of at most ``limit`` bytes.

    OSError with its reason in ``strerror`` for a file that cannot be read, a longer one, and anything else that has a path:
    a pipe without a writer would block the caller, a device such as /dev/zero never ends.
    """
    mode = path.stat().st_mode
    if not stat.S_ISREG(mode):
        found = "a directory" if stat.S_ISDIR(mode) else "a pipe or a device"
        raise OSError(errno.EINVAL, f"{found}, expected a file")
    with path.open("rb") as file:
        data = file.read(limit + 1)
    if len(data) > limit:
        raise OSError(errno.EFBIG, f"longer than {limit} bytes; check that it is the right file")
    return data
