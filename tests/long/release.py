"""``python -m tests.long.release FOLDER``: check the compiled wheels of a release, and complete its bill of materials.

`make release` builds, installs and lists the files by standard tools: build, pip, cyclonedx-py, sha256sum.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import sys
import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


class ReleaseError(Exception):
    """Why a wheel is not released, in one line."""


def patterns(name: str = "COMPILED") -> tuple[str, ...]:
    """Patterns of modules that setup.py compiles: ``COMPILED`` for wheels, ``SOAK`` for a soak only."""
    for item in ast.parse((ROOT / "setup.py").read_text(encoding="utf-8")).body:
        if isinstance(item, ast.Assign) and ast.unparse(item.targets[0]) == name:
            return tuple(ast.literal_eval(item.value))
    raise ReleaseError(f"setup.py: no {name}")


def modules(name: str = "COMPILED") -> list[str]:
    """Paths of these modules."""
    return [path.relative_to(ROOT).as_posix() for pattern in patterns(name) for path in sorted(ROOT.glob(pattern))]


def check(wheel: Path, pure: Path, compiled: list[str]) -> None:
    """ReleaseError unless a compiled wheel has the sources of the pure one, each module compiled, and no path of this machine."""
    with zipfile.ZipFile(wheel) as one, zipfile.ZipFile(pure) as two:
        files = {name: one.read(name) for name in one.namelist()}
        sources = {name: two.read(name) for name in two.namelist() if ".dist-info/" not in name}
    if "-manylinux" not in wheel.name:
        raise ReleaseError(f"{wheel.name}: not for any Linux distribution, expected a tag manylinux")
    if other := [name for name, data in sources.items() if files.get(name) != data]:
        raise ReleaseError(f"{wheel.name}: {other[0]} is not that of the commit, build the wheels again")
    libraries = {name.partition(".")[0]: data for name, data in files.items() if name.endswith(".so")}
    wanted = [f"pdgw/{module.removesuffix('.py')}" for module in compiled]
    if missing := [name for name in wanted if name not in libraries]:
        raise ReleaseError(f"{wheel.name}: {missing[0]} is not compiled")
    own = [os.fsencode(path) for path in (Path.home(), ROOT, tempfile.gettempdir())]
    if found := [name for name, data in libraries.items() if any(path in data for path in own)]:
        raise ReleaseError(f"{wheel.name}: {found[0]} contains a path of this machine")


def vendored() -> Iterator[dict[str, object]]:
    """Components that pip does not install: the third-party files of the page."""
    for item in json.loads((ROOT / "tools/web/static/vendor/vendored.json").read_text(encoding="utf-8")):
        purl = f"pkg:npm/{item['package']}@{item['version']}"
        licences = [{"license": {"id": item["licence"]}}]
        named = {"name": item["package"], "version": item["version"], "licenses": licences}
        yield {"type": "library", "bom-ref": purl, "purl": purl, **named}


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(prog="release", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", type=Path, help="the files of a release")
    folder: Path = parser.parse_args().folder
    (pure,), (bill,) = folder.glob("*-none-any.whl"), folder.glob("*.cdx.json")
    try:
        for wheel in sorted(set(folder.glob("*.whl")) - {pure}):
            check(wheel, pure, modules())
    except ReleaseError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    content = json.loads(bill.read_text(encoding="utf-8"))
    content["components"] += vendored()
    bill.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
