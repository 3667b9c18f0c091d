"""``python -m pdgw.workshop.installation FOLDER``: install the files of a release in a fresh environment and start the command.

Packages come from the pins alone, and pip refuses a file whose hash is not among them. The release's own wheel is checked against
SHA256SUMS first.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

from pdgw.workshop.release import PINS, SUMS, ReleaseError, digest


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(prog="installation", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", type=Path, help="the files of `make release`")
    folder: Path = parser.parse_args().folder
    try:
        print(f"installed with hashes: {installed(folder)}")
    except ReleaseError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def installed(folder: Path) -> str:
    """What the installed ``pdgw --version`` prints; ReleaseError when a step fails."""
    verify(folder)
    (wheel,) = folder.glob("*.whl")
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        venv.create(place, with_pip=True)
        pip = (str(place / "bin" / "pip"), "install", "--quiet", "--disable-pip-version-check")
        _run(*pip, "--require-hashes", "--requirement", str(folder / PINS))
        _run(*pip, "--no-deps", "--no-index", str(wheel))
        _run(str(place / "bin" / "pip"), "check")
        return _run(str(place / "bin" / "pdgw"), "--version").strip()


def verify(folder: Path) -> None:
    """Compare every file with SHA256SUMS; ReleaseError names the first that differs."""
    for line in (folder / SUMS).read_text(encoding="utf-8").splitlines():
        given, name = line.split("  ")
        if digest(folder / name) != given:
            raise ReleaseError(f"{name}: its SHA-256 is not that of {SUMS}")


def _run(*command: str) -> str:
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    if done.returncode:
        raise ReleaseError(f"{' '.join(command)}: {(done.stderr or done.stdout).strip()}")
    return done.stdout


if __name__ == "__main__":
    sys.exit(main())
