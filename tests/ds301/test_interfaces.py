"""CAN interfaces that cannot be opened on this machine: what is missing, and what to install."""

from __future__ import annotations

import re
from importlib.metadata import requires

import pytest
from can.interfaces import BACKENDS

from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.bus.interfaces import DRIVERS, obstacle, open_bus

_WITHOUT_NEEDS = {"virtual", "socketcand"}
_RAW = re.compile(r"\w+Error|No module|cannot import|is not defined|__init__|windll")
"""Python terms that mean nothing to a user."""


def test_every_interface_of_python_can_has_a_row() -> None:
    own = {name for name, (module, _) in BACKENDS.items() if module.startswith("can.interfaces.")}
    assert set(DRIVERS) == own - _WITHOUT_NEEDS


def test_packages_of_the_rows_are_those_that_python_can_requires() -> None:
    optional = [line.split(";")[0] for line in requires("python-can") or () if "extra ==" in line]
    known = {re.split(r"[<>=~! ]", line)[0] for line in optional}
    assert {row.remedy.split(";")[0].removeprefix("pip install ") for row in DRIVERS.values() if row.module} <= known


@pytest.mark.parametrize(
    ("interface", "system", "text"),
    [
        ("kvaser", "Linux", "its driver is missing on this machine: CANlib of Kvaser; on Linux interface = "),
        ("gs_usb", "Linux", "its driver is missing on this machine: pip install gs-usb; on Linux interface = "),
        ("slcan", "Windows", "its driver is missing on this machine: pip install pyserial"),
        ("ixxat", "Linux", "works only on Windows, with its driver: VCI of HMS Ixxat; on Linux interface = "),
        ("kvaser", "Darwin", "works only on Linux and Windows, with its driver: CANlib of Kvaser"),
        ("socketcan", "Windows", "works only on Linux"),
        ("socketcn", "Linux", "not an interface of python-can; did you mean socketcan? (allowed: canalystii, "),
    ],
)
def test_obstacle_names_what_to_install(interface: str, system: str, text: str) -> None:
    assert obstacle(interface, system).startswith(text)


def test_interface_without_needs_has_no_obstacle() -> None:
    assert [obstacle(name, "Linux") for name in ("virtual", "socketcan", "socketcand")] == ["", "", ""]


@pytest.mark.parametrize("interface", sorted(set(DRIVERS) - {"socketcan", "udp_multicast"}))
def test_error_of_an_interface_has_no_words_of_python(interface: str) -> None:
    with pytest.raises(CanopenError) as refused:
        open_bus(interface, "no-such-channel", 500_000)
    text = str(refused.value)
    assert text == f"CAN interface: '{interface} channel no-such-channel' cannot be opened: {obstacle(interface)}"
    assert not _RAW.search(text)
