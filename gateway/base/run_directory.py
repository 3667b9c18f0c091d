"""Folder of the rings: a run directory of this machine, in RAM."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from pdgw.gateway.base.errors import GatewayError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

SUFFIX = ".ring"
PREVIOUS = ".previous" + SUFFIX
_LOCK_MODE = 0o600
"""File mode: a user who can read the file could lock it."""
_LOCK_FLAGS = getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_NOFOLLOW", 0)
_NAMES = 9
"""Maximum number of gateways of one name on a machine, each with its own folder."""
_SHARED_MEMORY = Path("/dev/shm")
_SERVICES = Path("/run/pdgw")
"""The units of ``deploy/`` have a folder for each gateway here."""
_PRIVATE = 0o750
_WRITTEN_BY_OTHERS = 0o022


def run_directory() -> Path | None:
    """systemd's RuntimeDirectory, else ``pdgw`` in the XDG run directory, else the user's folder in /dev/shm; None: nowhere."""
    given = os.environ.get("RUNTIME_DIRECTORY", "").split(":")[0]
    if given:
        return Path(given).resolve()  # with a dynamic user it is a link to a private folder
    base = os.environ.get("XDG_RUNTIME_DIR", "")
    if base and Path(base).is_dir():
        return Path(base) / "pdgw"
    if _SHARED_MEMORY.is_dir() and hasattr(os, "getuid"):
        return _SHARED_MEMORY / f"pdgw-{os.getuid()}"
    return None


def prepared(directory: Path) -> Path:
    """The directory, made when it is missing; GatewayError if it cannot be used, or if other users own it or may write in it."""
    try:
        directory.mkdir(mode=_PRIVATE, parents=True, exist_ok=True)
        found = directory.lstat()
    except OSError as error:
        raise GatewayError(f"flight recorder: {directory}: {error.strerror or error}") from error
    if not stat.S_ISDIR(found.st_mode):
        raise GatewayError(f"flight recorder: {directory}: not a directory")
    # In a folder where all users may create files, another user could create ours first and delete it later.
    if hasattr(os, "getuid") and found.st_uid not in (0, os.getuid()):
        raise GatewayError(f"flight recorder: {directory}: belongs to another user")
    if hasattr(os, "getuid") and found.st_mode & _WRITTEN_BY_OTHERS:
        mode = stat.S_IMODE(found.st_mode)
        raise GatewayError(
            f"flight recorder: {directory}: other users may write in it (mode {mode:04o}), allowed: 0750"
        )
    return directory


def locked(directory: Path, name: str) -> tuple[Path, int]:
    """The path of a ring that no living gateway has, and the lock that says so. OSError if there is none."""
    for number in range(1, _NAMES + 1):
        stem = name if number == 1 else f"{name}-{number}"
        lock = os.open(directory / f"{stem}.lock", os.O_RDWR | os.O_CREAT | _LOCK_FLAGS, _LOCK_MODE)
        try:
            if fcntl is not None:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(lock)
            continue
        return directory / (stem + SUFFIX), lock
    raise OSError(0, f"{_NAMES} gateways with the name {name} are already running")


def run_directories() -> set[Path]:
    """The run directory, and those of the gateways that are services."""
    return {path for path in (run_directory(), _SERVICES, *_SERVICES.glob("*/")) if path is not None}


def rings(directory: Path | None = None) -> list[Path]:
    """The rings in a directory, the newest first; None: in all run directories."""
    found: list[tuple[float, Path]] = []
    for place in run_directories() if directory is None else {directory}:
        try:
            found += [(path.stat().st_mtime, path) for path in place.glob(f"*{SUFFIX}")]
        except OSError:
            continue  # it belongs to another user, or was deleted meanwhile
    return [path for _, path in sorted(found, reverse=True)]
