"""``python -m pdgw.workshop.release FOLDER``: sources, wheel, bill of materials, pins and checksums of the last commit.

Everything is built twice: the wheel from the commit, then from the source distribution of the first time in another folder. A
release whose files differ by a byte is not written. Times are those of SOURCE_DATE_EPOCH, else of the commit.
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
from pathlib import Path

from pdgw.workshop.sbom import ROOT, document

_INFO = "PKG-INFO"
PINS = "requirements.txt"
"""In a release: pins/runtime.txt, the packages that it needs with the hashes of their files."""
SUMS = "SHA256SUMS"


class ReleaseError(Exception):
    """Why there is no release, in one line."""


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(prog="release", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", type=Path, help="an empty or new folder for the files")
    folder: Path = parser.parse_args().folder
    try:
        for path in release(folder):
            print(f"{digest(path)}  {path.name}")
    except ReleaseError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def release(folder: Path) -> list[Path]:
    """Write the files of a release; ReleaseError when the two builds differ or the folder has files."""
    if folder.exists() and any(folder.iterdir()):
        raise ReleaseError(f"{folder}: has files, allowed: an empty or new folder")
    epoch = int(os.environ.get("SOURCE_DATE_EPOCH") or _git("log", "-1", "--format=%ct"))
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        first, second = work / "first", work / "second" / "deeper"
        commit = subprocess.run(["git", "archive", "HEAD"], cwd=ROOT, check=True, capture_output=True).stdout
        unpack(commit, first)
        built = _built(first, work / "one", epoch)
        with gzip.open(built[0]) as file:
            unpack(file.read(), second)
        again = _built(next(second.iterdir()), work / "two", epoch)
        for one, two in zip(built, again, strict=True):
            if one.name != two.name or one.read_bytes() != two.read_bytes():
                raise ReleaseError(f"{one.name}: the second build differs from the first one")
        folder.mkdir(parents=True, exist_ok=True)
        files = [Path(shutil.copyfile(path, folder / path.name)) for path in built]
    version = files[0].name.removesuffix(".tar.gz").rpartition("-")[2]
    bill = folder / f"{files[0].name.removesuffix('.tar.gz')}.cdx.json"
    bill.write_text(json.dumps(document(version, epoch), indent=1) + "\n", encoding="utf-8")
    copied = {"CHANGELOG.md": ROOT / "CHANGELOG.md", PINS: ROOT / "pins" / "runtime.txt"}
    files += [bill, *(Path(shutil.copyfile(path, folder / name)) for name, path in copied.items())]
    sums = folder / SUMS
    sums.write_text("".join(f"{digest(path)}  {path.name}\n" for path in files), encoding="utf-8")
    return [*files, sums]


def _built(tree: Path, folder: Path, epoch: int) -> list[Path]:
    """Source distribution and wheel of a tree."""
    files = sources(tree)  # the build adds some
    environment = os.environ | {"SOURCE_DATE_EPOCH": str(epoch), "PIP_CONSTRAINT": str(tree / "constraints.txt")}
    command = [
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "--quiet",
        "--disable-pip-version-check",
        "--no-deps",
        "--no-cache-dir",
    ]
    done = subprocess.run(
        [*command, "-w", str(folder), str(tree)],
        env=environment,
        umask=0o022,  # the wheel has the modes of files that the build writes
        check=False,
        capture_output=True,
        text=True,
    )
    if done.returncode:
        raise ReleaseError(f"the wheel is not built: {(done.stderr or done.stdout).strip().splitlines()[-1]}")
    (wheel,) = folder.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        (metadata,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        info = archive.read(metadata)
    sdist = folder / f"{'-'.join(wheel.name.split('-')[:2])}.tar.gz"
    files[_INFO] = info, 0o644
    sdist.write_bytes(source_distribution(files, sdist.name.removesuffix(".tar.gz"), epoch))
    return [sdist, wheel]


def unpack(archive: bytes, folder: Path) -> None:
    """The files of a tar archive with modes that do not depend on this machine's umask."""
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
    """A ``.tar.gz``: its bytes depend on names, contents, execute bits and ``epoch`` alone."""
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


def _git(*arguments: str) -> str:
    return subprocess.run(["git", *arguments], cwd=ROOT, check=True, capture_output=True, text=True).stdout.strip()


if __name__ == "__main__":
    sys.exit(main())
