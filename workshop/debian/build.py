"""``python -m pdgw.workshop.debian.build RELEASE FOLDER``: build the Debian package of a release with dpkg-deb.

The package has a Python environment of its own in /opt/pdgw, because Debian's packages of the dependencies are older than
the gateway allows. Its files come from the pins and are checked by their hashes. It needs Debian's Python of the version
that builds it. The same release gives the same bytes.
"""

from __future__ import annotations

import argparse
import gzip
import os
import shutil
import sys
import tempfile
from pathlib import Path

from pdgw.gateway.configuration.example import example
from pdgw.workshop.debian.man import pages
from pdgw.workshop.installation import verify, version_of
from pdgw.workshop.release import PINS, ReleaseError, commit_time, run
from pdgw.workshop.sbom import ROOT

NAME = "profidrive-gateway"
DEPLOY = ROOT / "deploy"
SCRIPTS = ("postinst", "prerm", "postrm")
CONFIGURATION = "etc/pdgw/gateway.toml"
CONFFILES = (CONFIGURATION,)
_PYTHON = f"{sys.version_info.major}.{sys.version_info.minor}"
_NEXT_PYTHON = f"{sys.version_info.major}.{sys.version_info.minor + 1}"


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(prog="build", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("release", type=Path, help="the files of `make release`")
    parser.add_argument("folder", type=Path, help="where the package is written")
    parser.add_argument("--revision", default="1", help="the Debian revision after the version")
    given = parser.parse_args()
    try:
        verify(given.release)
        version = version_of(given.release)
        with tempfile.TemporaryDirectory() as name:
            tree = Path(name) / "tree"
            environment(tree, given.release)
            contents(tree, version)
            print(package(tree, f"{version}-{given.revision}", given.folder))
    except ReleaseError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def environment(tree: Path, release: Path) -> None:
    """Create /opt/pdgw: Debian's Python with the pinned packages and the gateway."""
    top = tree / "opt" / "pdgw"
    packages = top / "lib" / f"python{_PYTHON}" / "site-packages"
    packages.mkdir(parents=True)
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-compile"]
    own = ["--no-deps", "--no-index", "--find-links", str(release), f"{NAME}=={version_of(release)}"]
    for arguments in (["--require-hashes", "--requirement", str(release / PINS)], own):
        run(*pip, "--upgrade", "--target", str(packages), *arguments)
    shutil.rmtree(packages / "bin", ignore_errors=True)  # scripts with the path of the building Python
    for name in ("direct_url.json", "RECORD"):  # contain paths of this machine
        for path in packages.glob(f"*.dist-info/{name}"):
            path.unlink()


def contents(tree: Path, version: str) -> None:
    """Create everything in the package except the Python packages."""
    top = tree / "opt" / "pdgw"
    (top / "bin").mkdir(parents=True)
    (top / "bin" / "python3").symlink_to(f"/usr/bin/python{_PYTHON}")
    _write(top / "pyvenv.cfg", f"home = /usr/bin\ninclude-system-site-packages = false\nversion = {_PYTHON}\n")
    start = "#!/opt/pdgw/bin/python3\nfrom pdgw.__main__ import run\n\nraise SystemExit(run())\n"
    _write(top / "bin" / "pdgw", start, 0o755)
    (tree / "usr" / "bin").mkdir(parents=True)
    (tree / "usr" / "bin" / "pdgw").symlink_to("/opt/pdgw/bin/pdgw")
    units = DEPLOY / "systemd"
    for path in units.glob("*@.service"):
        _copy(path, tree / "usr/lib/systemd/system" / path.name)
    _copy(units / "pdgw.conf", tree / "usr/lib/sysusers.d/pdgw.conf")
    documents = tree / "usr/share/doc" / NAME
    for name in ("realtime.conf", "raw-sockets.conf", "80-can.network"):
        _copy(units / name, documents / "systemd" / name)
    _copy(ROOT / "LICENSE", documents / "copyright")
    _write_compressed(documents / "changelog.gz", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"))
    _write(tree / CONFIGURATION, example())
    for name, text in pages(version).items():
        _write_compressed(tree / "usr/share/man/man1" / f"{name}.gz", text)


def package(tree: Path, version: str, folder: Path) -> Path:
    """Build the package. ReleaseError when dpkg-deb is missing or fails."""
    if shutil.which("dpkg-deb") is None:
        raise ReleaseError("dpkg-deb: not found, needed: Debian's package dpkg")
    control = tree / "DEBIAN"
    control.mkdir()
    files = [
        path for path in tree.rglob("*") if path.is_file() and not path.is_symlink() and control not in path.parents
    ]
    native = any(path.suffix == ".so" for path in files)
    asked = ["dpkg", "--print-architecture"]
    machine = run(*asked).strip() if native else "all"
    size = sum(path.stat().st_size for path in files) // 1024
    _write(control / "control", _control(version, machine, size))
    _write(control / "conffiles", "".join(f"/{name}\n" for name in CONFFILES))
    for name in SCRIPTS:
        _copy(DEPLOY / "debian" / name, control / name, 0o755)
    for path in tree.rglob("*"):
        if path.is_dir():
            path.chmod(0o755)
        elif not path.is_symlink():
            path.chmod(0o755 if path.stat().st_mode & 0o100 else 0o644)
    folder.mkdir(parents=True, exist_ok=True)
    made = folder / f"{NAME}_{version}_{machine}.deb"
    times = os.environ | {"SOURCE_DATE_EPOCH": str(commit_time())}
    run("dpkg-deb", "--root-owner-group", "-Zxz", "-z6", "--build", str(tree), str(made), env=times)
    return made


def _control(version: str, machine: str, size_kib: int) -> str:
    return f"""Package: {NAME}
Version: {version}
Architecture: {machine}
Maintainer: profidrive-gateway <profidrive-gateway@invalid>
Section: net
Priority: optional
Installed-Size: {size_kib}
Depends: python3 (>= {_PYTHON}), python3 (<< {_NEXT_PYTHON}), systemd | systemd-standalone-sysusers
Recommends: iproute2
Description: PROFIdrive-to-CANopen gateway
 A PLC commands CiA 402 drives and CiA 406 encoders with PROFIdrive telegrams
 over UDP or PROFINET. The package contains the gateway, its web page and the
 tools of the command pdgw. No gateway is started by the installation.
"""


def _write(path: Path, text: str, mode: int = 0o644) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    path.chmod(mode)


def _write_compressed(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(gzip.compress(text.encode(), mtime=0))


def _copy(source: Path, target: Path, mode: int = 0o644) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source, target)
    target.chmod(mode)


if __name__ == "__main__":
    sys.exit(main())
