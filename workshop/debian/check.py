"""``python -m pdgw.workshop.debian.check PACKAGE``: install, start, upgrade, remove and purge the Debian package.

It works on a copy of this machine's file system (an overlay in memory) with its own processes and network. The machine
itself is not changed. Needs root or user namespaces, and Debian's Python of the package. Prints one line for each step.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from pdgw.workshop.debian.build import CONFIGURATION, NAME

_INSIDE = "PDGW_DEBIAN_CHECK"
"""Mount point of the copy; set for the process in the namespaces."""
_PATIENCE_S = 120
_UNKNOWN = 3
"""Exit code of ``pdgw status --check`` when no gateway answers."""
_START = (
    "mkdir -p /run/pdgw/check /var/lib/pdgw/check && chown -R pdgw:pdgw /run/pdgw /var/lib/pdgw && "
    "exec setpriv --reuid pdgw --regid pdgw --init-groups env HOME=/ RUNTIME_DIRECTORY=/run/pdgw/check "
    "STATE_DIRECTORY=/var/lib/pdgw/check pdgw run --simulate --log-format text"
)
_FAKE_SYSTEMCTL = '#!/bin/sh\n[ "$1" != list-units ] || echo "pdgw@press.service loaded active running x"\n'


class CheckError(Exception):
    """What the package did wrong, in one line."""


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(prog="check", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("package", type=Path, help="the package of `make deb`")
    package: Path = parser.parse_args().package.resolve()
    place = os.environ.get(_INSIDE)
    if place is None:
        return _in_namespaces(package)
    try:
        check(package, Root(Path(place)))
    except CheckError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print("the package passed")
    return 0


def _in_namespaces(package: Path) -> int:
    words = ["unshare", "--mount", "--net", "--pid", "--fork", "--kill-child"]
    if os.geteuid() != 0:
        words += ["--user", "--map-root-user"]
    command = [*words, sys.executable, "-m", "pdgw.workshop.debian.check", str(package)]
    place = tempfile.mkdtemp()
    try:
        return subprocess.run(command, env=os.environ | {_INSIDE: place}, check=False).returncode
    finally:
        os.rmdir(place)  # empty again: its mounts ended with the namespace


class Root:
    """The file system that the package changes."""

    def __init__(self, place: Path) -> None:
        _run("mount", "-t", "tmpfs", "tmpfs", str(place))
        upper, work, self.top = (place / name for name in ("upper", "work", "top"))
        for path in (upper, work, self.top):
            path.mkdir()
        options = f"lowerdir=/,upperdir={upper},workdir={work}"
        _run("mount", "-t", "overlay", "overlay", "-o", options, str(self.top))
        _run("mount", "-t", "proc", "proc", str(self.top / "proc"))
        for name in ("run", "tmp", "dev"):
            _run("mount", "-t", "tmpfs", "tmpfs", str(self.top / name))
        for name in ("null", "zero", "random", "urandom"):
            device = self.top / "dev" / name
            device.touch()
            _run("mount", "--bind", f"/dev/{name}", str(device))
        (self.top / "dev" / "shm").mkdir(mode=0o1777)
        _run("ip", "link", "set", "lo", "up")

    def command(self, *words: str) -> list[str]:
        """Command line that runs a command on this file system."""
        path = "PATH=/usr/sbin:/usr/bin:/sbin:/bin"
        return ["chroot", str(self.top), "env", "-i", path, "DEBIAN_FRONTEND=noninteractive", *words]

    def __call__(self, *words: str) -> str:
        """Run a command to its end; CheckError unless it succeeds."""
        return _run(*self.command(*words))

    def fails(self, *words: str) -> str:
        """Run a command that must fail. Return its output."""
        done = subprocess.run(self.command(*words), check=False, capture_output=True, text=True)
        if done.returncode == 0:
            raise CheckError(f"{' '.join(words)}: succeeds, expected an error")
        return done.stdout + done.stderr

    def has(self, path: str) -> bool:
        """Whether a file or folder exists."""
        return os.path.lexists(self.top / path.lstrip("/"))


def check(package: Path, root: Root) -> None:
    """Run all steps; CheckError at the first failure."""
    first = Path(shutil.copy(package, root.top / "tmp")).name
    newer = repacked(root.top / "tmp" / first).name
    _report("installed", _install(root, first))
    _report("users", root("id", "pdgw-web").strip())
    _expect("(pdgw)" in root("id", "pdgw-web"), "pdgw-web is not in the group pdgw")
    units = [f"{name}@gateway.service" for name in ("pdgw", "pdgw-web")]
    if root.has("/usr/bin/systemd-analyze"):
        _report("units verified", root("systemd-analyze", "verify", "--man=no", *units).strip() or "no complaint")
    as_gateway = ("setpriv", "--reuid", "pdgw", "--regid", "pdgw", "--init-groups")
    _report("configuration", root(*as_gateway, "pdgw", "config", "check", f"/{CONFIGURATION}").splitlines()[0])
    _report("started as pdgw", _started(root))
    _report("upgraded", _upgraded(root, newer))
    _report("upgrade refused while a gateway runs", _refused(root, first))
    root("dpkg", "--remove", NAME)
    _expect(root.has(f"/{CONFIGURATION}") and root.has("/var/lib/pdgw/check"), "a removal lost configuration or state")
    _expect(not root.has("/opt/pdgw") and not root.has("/usr/bin/pdgw"), "a removal left the program")
    _report("removed", "configuration and state are kept")
    root("dpkg", "--purge", NAME)
    left = [path for path in (f"/{CONFIGURATION}", "/var/lib/pdgw") if root.has(path)]
    _expect(not left, f"a purge left {left}")
    _expect(root.has("/etc/pdgw/press.toml"), "a purge removed a configuration that is not of the package")
    _report("purged", "a configuration of the user is kept")


def repacked(package: Path) -> Path:
    """Build the same package with a higher revision."""
    tree = package.parent / "tree"
    _run("dpkg-deb", "--raw-extract", str(package), str(tree))
    control = tree / "DEBIAN" / "control"
    text = control.read_text(encoding="utf-8")
    version = next(line.partition(" ")[2] for line in text.splitlines() if line.startswith("Version:"))
    control.write_text(text.replace(f"Version: {version}", f"Version: {version}.1"), encoding="utf-8")
    made = package.with_name(package.name.replace(f"_{version}_", f"_{version}.1_"))
    _run("dpkg-deb", "--root-owner-group", "-Znone", "--build", str(tree), str(made))
    shutil.rmtree(tree)
    return made


def _install(root: Root, file: str) -> str:
    root("dpkg", "--install", f"/tmp/{file}")
    return root("dpkg-query", "--show", "--showformat=${Version} ${Status} ${Installed-Size} KiB", NAME)


def _started(root: Root) -> str:
    """Start with simulated devices, read the status, stop."""
    gateway = subprocess.Popen(root.command("sh", "-c", _START), stderr=subprocess.PIPE, text=True)
    answer = ""

    def answers() -> bool:
        nonlocal answer
        done = subprocess.run(root.command("pdgw", "status", "--check"), check=False, capture_output=True, text=True)
        answer = done.stdout.strip()
        return done.returncode != _UNKNOWN or gateway.poll() is not None

    _wait(answers, "the gateway does not answer")
    gateway.send_signal(signal.SIGTERM)
    _, log = gateway.communicate(timeout=_PATIENCE_S)
    _expect(gateway.returncode == 0, f"the gateway ended with status {gateway.returncode}: {log[-300:]}")
    return answer


def _upgraded(root: Root, file: str) -> str:
    """Install a newer revision over a changed configuration and a stored state."""
    configuration = root.top / CONFIGURATION
    configuration.write_text(configuration.read_text(encoding="utf-8") + "# mine\n", encoding="utf-8")
    shutil.copy(configuration, configuration.with_name("press.toml"))
    version = _install(root, file)
    _expect(configuration.read_text(encoding="utf-8").endswith("# mine\n"), "an upgrade lost the configuration")
    _expect(root.has("/var/lib/pdgw/check"), "an upgrade lost the state")
    return version


def _refused(root: Root, file: str) -> str:
    """While systemd reports a running gateway, an upgrade must replace nothing."""
    (root.top / "run/systemd/system").mkdir(parents=True)
    systemctl = root.top / "usr/bin/systemctl"
    systemctl.unlink(missing_ok=True)
    systemctl.write_text(_FAKE_SYSTEMCTL)
    systemctl.chmod(0o755)
    text = root.fails("dpkg", "--install", f"/tmp/{file}")
    shutil.rmtree(root.top / "run/systemd")
    _expect("bring the machine to a stop, then: systemctl stop pdgw@press.service" in text, text)
    _expect(
        "ok installed" in root("dpkg-query", "--show", "--showformat=${Status}", NAME), "the package is half installed"
    )
    return "systemctl stop pdgw@press.service"


def _wait(condition: Callable[[], bool], otherwise: str) -> None:
    end = time.monotonic() + _PATIENCE_S
    while not condition():
        _expect(time.monotonic() < end, otherwise)
        time.sleep(0.2)


def _expect(condition: bool, otherwise: str) -> None:
    if not condition:
        raise CheckError(otherwise)


def _report(step: str, text: str) -> None:
    print(f"{step}: {text}", flush=True)


def _run(*command: str) -> str:
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    if done.returncode:
        raise CheckError(f"{' '.join(command)}: {(done.stderr or done.stdout).strip()}")
    return done.stdout


if __name__ == "__main__":
    sys.exit(main())
