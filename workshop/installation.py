"""``python -m pdgw.workshop.installation FOLDER``: install a release in a new environment and start the command.

Packages come only from the pins, and pip rejects a file with another hash. The release's own files are first compared with
SHA256SUMS. Of its wheels pip takes the one compiled for this machine and Python, else the pure Python one.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from pdgw.web.support import PACKAGE
from pdgw.workshop.release import PINS, SUMS, ReleaseError, digest, run


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
    """Output of the installed ``pdgw --version``. ReleaseError when a step fails."""
    verify(folder)
    with tempfile.TemporaryDirectory() as name:
        fresh = Environment(Path(name))
        files = folder.absolute()
        fresh.install("--require-hashes", "--requirement", str(files / PINS))
        fresh.install("--no-deps", "--no-index", "--find-links", str(files), f"{PACKAGE}=={version_of(folder)}")
        fresh.run("pip", "check")
        return fresh.run("pdgw", "--version").strip()


def version_of(folder: Path) -> str:
    """Version of the files of a release."""
    (sdist,) = folder.glob("*.tar.gz")
    return sdist.name.removesuffix(".tar.gz").rpartition("-")[2]


class Environment:
    """A virtual environment of its own."""

    def __init__(self, place: Path, python: Path = Path(sys.executable)) -> None:
        self.place = place
        run(str(python), "-m", "venv", str(place))

    def install(self, *arguments: str) -> None:
        """Call ``pip install``."""
        self.run("pip", "install", "--quiet", "--disable-pip-version-check", *arguments)

    def run(self, program: str, *arguments: str) -> str:
        """Run an installed program in the folder of the environment. Return its output."""
        return run(str(self.place / "bin" / program), *arguments, cwd=self.place)


def verify(folder: Path) -> None:
    """Compare every file with SHA256SUMS. ReleaseError names the first that differs."""
    for line in (folder / SUMS).read_text(encoding="utf-8").splitlines():
        given, name = line.split("  ")
        if digest(folder / name) != given:
            raise ReleaseError(f"{name}: its SHA-256 is not that of {SUMS}")


if __name__ == "__main__":
    sys.exit(main())
