"""CAN interfaces that fail: what is said, and that their end makes no noise."""

from __future__ import annotations

import errno
import gc
import os
import sys
from typing import Any

import can
import pytest

from pdgw.ds301.bus import open_bus, system_text
from pdgw.ds301.errors import CanopenError
from pdgw.ds301.loop import SystemLoop
from pdgw.ds301.port import open_port


class Gone(can.BusABC):
    """A bus whose server has gone: nothing comes, and closing it fails."""

    def __init__(self) -> None:
        super().__init__("gone")

    def _recv_internal(self, _timeout: float | None) -> tuple[None, bool]:
        raise can.CanOperationError("closed unexpectedly")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise can.CanOperationError("closed unexpectedly")

    def shutdown(self) -> None:
        raise OSError(errno.ENOTCONN, "Transport endpoint is not connected")


def test_a_bus_whose_server_has_gone_is_released_once_and_silently(monkeypatch: pytest.MonkeyPatch) -> None:
    unraisable: list[Any] = []
    monkeypatch.setattr(sys, "unraisablehook", unraisable.append)
    loop = SystemLoop()
    port = open_port(loop, Gone())
    port.close()
    port.close()
    del port
    loop.close()
    gc.collect()
    assert unraisable == []


@pytest.mark.parametrize(
    ("number", "text"),
    [
        (errno.ENETDOWN, "Network is down; bring it up: sudo ip link set can1 up type can bitrate 500000"),
        (errno.ENODEV, "No such device; those there are: ip link show type can"),
        (errno.EPERM, "Operation not permitted"),
    ],
)
def test_an_interface_that_is_down_is_told_with_the_command_that_helps(number: int, text: str) -> None:
    assert system_text(OSError(number, os.strerror(number)), "can1", 500_000) == text


def test_an_interface_that_is_not_there_is_told_with_how_to_see_those_that_are(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(**_: object) -> can.BusABC:
        raise OSError(errno.ENODEV, "No such device")

    monkeypatch.setattr(can, "Bus", missing)
    with pytest.raises(CanopenError, match="No such device; those there are: ip link show type can"):
        open_bus("socketcan", "can7")
