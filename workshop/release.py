"""``python -m pdgw.workshop.release FOLDER``: sources, wheels, bill of materials, pins and checksums of the last commit.

Sources and pure Python wheel are built twice: from the commit, then from the first source distribution in another folder. A
release whose files differ by a byte is not written. The compiled wheels of ``make wheels`` are added if they have the same
sources. File times are SOURCE_DATE_EPOCH, else the time of the commit.
"""

from __future__ import annotations

import argparse
import gzip
import hashlib
import io
import json
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path

from pdgw.workshop.sbom import ROOT, document

_INFO = "PKG-INFO"
PINS = "requirements.txt"
"""File in a release: ``PINS_OF_RUNTIME``, the required packages with the hashes of their files."""
PINS_OF_RUNTIME = ROOT / "pins" / "runtime.txt"
SUMS = "SHA256SUMS"


class ReleaseError(Exception):
    """Why there is no release, in one line."""


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(prog="release", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", type=Path, help="an empty or new folder for the files")
    parser.add_argument("--wheels", type=Path, help="the folder of `make wheels`")
    given = parser.parse_args()
    try:
        for path in release(given.folder, given.wheels):
            print(f"{digest(path)}  {path.name}")
    except ReleaseError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def release(folder: Path, wheels: Path | None = None) -> list[Path]:
    """Write the files of a release. ReleaseError when the builds differ, a wheel of ``wheels`` has other sources, or the
    folder is not empty.
    """
    if folder.exists() and any(folder.iterdir()):
        raise ReleaseError(f"{folder}: has files, allowed: an empty or new folder")
    epoch = commit_time()
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        first, second = work / "first", work / "second" / "deeper"
        unpack(commit(), first)
        built = _built(first, work / "one", epoch)
        with gzip.open(built[0]) as file:
            unpack(file.read(), second)
        again = _built(next(second.iterdir()), work / "two", epoch)
        for one, two in zip(built, again, strict=True):
            if one.name != two.name or one.read_bytes() != two.read_bytes():
                raise ReleaseError(f"{one.name}: the second build differs from the first one")
        added = sorted(wheels.glob("*.whl")) if wheels else []
        for path in added:
            same_sources(path, built[1])
        folder.mkdir(parents=True, exist_ok=True)
        files = [Path(shutil.copyfile(path, folder / path.name)) for path in [*built, *added]]
    version = files[0].name.removesuffix(".tar.gz").rpartition("-")[2]
    bill = folder / f"{files[0].name.removesuffix('.tar.gz')}.cdx.json"
    bill.write_text(json.dumps(document(version, epoch), indent=1) + "\n", encoding="utf-8")
    copied = {"CHANGELOG.md": ROOT / "CHANGELOG.md", PINS: PINS_OF_RUNTIME}
    files += [bill, *(Path(shutil.copyfile(path, folder / name)) for name, path in copied.items())]
    sums = folder / SUMS
    sums.write_text("".join(f"{digest(path)}  {path.name}\n" for path in files), encoding="utf-8")
    return [*files, sums]


def same_sources(wheel: Path, pure: Path) -> None:
    """ReleaseError unless a compiled wheel contains every file of the package, equal to the pure one."""
    with zipfile.ZipFile(wheel) as one, zipfile.ZipFile(pure) as two:
        names = set(one.namelist())
        for name in two.namelist():
            if ".dist-info/" not in name and (name not in names or one.read(name) != two.read(name)):
                raise ReleaseError(f"{wheel.name}: {name} is not that of the commit, build the wheels again")


def _built(tree: Path, folder: Path, epoch: int) -> list[Path]:
    """Build source distribution and wheel of a tree."""
    files = sources(tree)  # read first: the build adds files
    wheel = built_wheel(tree, folder, epoch)
    with zipfile.ZipFile(wheel) as archive:
        (metadata,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        info = archive.read(metadata)
    sdist = folder / f"{'-'.join(wheel.name.split('-')[:2])}.tar.gz"
    files[_INFO] = info, 0o644
    sdist.write_bytes(source_distribution(files, sdist.name.removesuffix(".tar.gz"), epoch))
    return [sdist, wheel]


def built_wheel(
    tree: Path, folder: Path, epoch: int, *, python: Path = Path(sys.executable), more: Mapping[str, str] | None = None
) -> Path:
    """Build the wheel of a tree with this Python. ``more``: further environment variables."""
    words = ("wheel", "--quiet", "--disable-pip-version-check", "--no-deps", "--no-cache-dir")
    constraints = {"PIP_CONSTRAINT": str(tree / "constraints.txt"), "SOURCE_DATE_EPOCH": str(epoch)}
    environment = {**os.environ, **constraints, **(more or {})}
    run(str(python), "-m", "pip", *words, "-w", str(folder), str(tree), env=environment)
    (wheel,) = folder.glob("*.whl")
    return wheel


def run(*command: str, env: Mapping[str, str] | None = None, cwd: Path | None = None) -> str:
    """Run a command, return its output. ReleaseError with its last line when it fails. Its files get the usual modes."""
    done = subprocess.run(command, env=env, cwd=cwd, umask=0o022, check=False, capture_output=True, text=True)
    if done.returncode:
        *_, last = (done.stderr or done.stdout).strip().splitlines() or [f"exit status {done.returncode}"]
        raise ReleaseError(f"{' '.join(command)}: {last}")
    return done.stdout


def commit() -> bytes:
    """The files of the last commit, as a tar archive."""
    return subprocess.run(["git", "archive", "HEAD"], cwd=ROOT, check=True, capture_output=True).stdout


def commit_time() -> int:
    """SOURCE_DATE_EPOCH, else the time of the last commit, in seconds since 1970."""
    return int(os.environ.get("SOURCE_DATE_EPOCH") or run("git", "log", "-1", "--format=%ct", cwd=ROOT))


def unpack(archive: bytes, folder: Path) -> None:
    """Unpack a tar archive with modes that do not depend on this machine's umask."""
    folder.mkdir(parents=True)
    with tarfile.open(fileobj=io.BytesIO(archive)) as file:
        file.extractall(folder, filter="data")
    for path in folder.rglob("*"):
        path.chmod(_mode(path))


def sources(tree: Path) -> dict[str, tuple[bytes, int]]:
    """Content and mode of each file, by its path in the tree."""
    files = (path for path in tree.rglob("*") if path.is_file())
    return {path.relative_to(tree).as_posix(): (path.read_bytes(), _mode(path)) for path in files}


def source_distribution(files: dict[str, tuple[bytes, int]], name: str, epoch: int) -> bytes:
    """A ``.tar.gz`` whose bytes depend only on names, contents, execute bits and ``epoch``."""
    tar = io.BytesIO()
    with tarfile.open(fileobj=tar, mode="w", format=tarfile.PAX_FORMAT) as archive:
        for path, (data, mode) in sorted(files.items()):
            item = tarfile.TarInfo(f"{name}/{path}")
            item.size, item.mtime, item.mode = len(data), epoch, mode
            archive.addfile(item, io.BytesIO(data))
    return gzip.compress(tar.getvalue(), mtime=epoch)


def _mode(path: Path) -> int:
    return 0o755 if path.is_dir() or path.stat().st_mode & 0o100 else 0o644


def digest(path: Path) -> str:
    """SHA-256, hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


if __name__ == "__main__":
    sys.exit(main())
