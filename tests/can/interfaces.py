"""CAN interfaces as ``ip`` of iproute2 makes them."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from tests.support.buses import PATIENCE_S

_DEVICES = Path("/sys/class/net")
_DRIVER = Path("/sys/bus/pci/drivers/kvaser_pci")
_FD_MTU = "72"


def ip(*arguments: str) -> None:
    """``ip link`` with these arguments."""
    subprocess.run(["ip", "link", *arguments], check=True, timeout=PATIENCE_S)


def up(name: str, *, bitrate: int = 1_000_000, more: tuple[str, ...] = ()) -> None:
    """As the README says; a virtual interface has no bit rate."""
    ip("set", name, "up", *(("type", "can", "bitrate", str(bitrate), *more) if is_controller(name) else ()))


def is_controller(name: str) -> bool:
    """Whether an interface has real or emulated hardware."""
    return (_DEVICES / name / "device").exists()


@dataclass(frozen=True)
class Wire:
    """Two ends of one wire."""

    near: str
    far: str

    def unplug(self) -> None:
        """Remove the near interface, like that of an unplugged adapter."""
        if is_controller(self.near):
            slot = (_DEVICES / self.near / "device").resolve().name
            (_DRIVER / "unbind").write_text(slot)
            _unplugged[self.near] = slot
        else:
            ip("del", self.near)

    def plug(self) -> bool:
        """Bring it back, up. False: the far interface was created again with it."""
        slot = _unplugged.pop(self.near, None)
        if slot is None:
            _tunnel(self)
            return False
        (_DRIVER / "bind").write_text(slot)
        up(self.near)
        return True


_unplugged: dict[str, str] = {}
"""Where the controllers are that were pulled out."""


def _tunnel(ends: Wire) -> None:
    ip("add", ends.near, "type", "vxcan", "peer", "name", ends.far)
    for name in (ends.near, ends.far):
        up(name)


@contextmanager
def wire() -> Iterator[Wire]:
    """can0 and can1: two controllers where there are some, else the ends of a tunnel of the kernel."""
    ends = Wire("can0", "can1")
    if is_controller(ends.near):
        for name in (ends.near, ends.far):
            up(name)
        yield ends
        for name in (ends.near, ends.far):
            ip("set", name, "down")
    else:
        _tunnel(ends)
        yield ends
        ip("del", ends.near)


@contextmanager
def vcan(name: str) -> Iterator[str]:
    """A virtual bus for classical and FD frames."""
    ip("add", name, "mtu", _FD_MTU, "type", "vcan")
    up(name)
    yield name
    ip("del", name)
