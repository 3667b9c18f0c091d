"""CAN interfaces of python-can: what each needs on a machine, and opening one with errors that a user can act on."""

from __future__ import annotations

import ctypes
import errno
import platform
from collections.abc import Mapping
from importlib import import_module
from importlib.util import find_spec
from typing import Final, NamedTuple

import can
from can.interfaces import BACKENDS

from pdgw.base.phrases import did_you_mean
from pdgw.ds301.aborts import CanopenError

_SOCKETCAN: Final = '; on Linux interface = "socketcan" works with these adapters, too'
"""A driver of the kernel or of the vendor makes them an interface of SocketCAN."""


class Driver(NamedTuple):
    """What an interface of python-can needs beside python-can."""

    remedy: str
    """What to install."""
    module: str = ""
    """The Python module of the driver; "" if it is a library of the vendor."""
    libraries: str = ""
    """Names of the library, one for each system; "" if it is not looked for."""
    systems: str = ""
    """The systems on which it works, as text with the names of ``platform.system``; "" for all."""


_SERIAL: Final = Driver("pip install pyserial", "serial")

DRIVERS: Final[Mapping[str, Driver]] = {
    "canalystii": Driver("pip install canalystii", "canalystii"),
    "cantact": Driver("pip install cantact" + _SOCKETCAN, "cantact"),
    "etas": Driver("ETAS BOA" + _SOCKETCAN, systems="Windows"),
    "gs_usb": Driver("pip install gs-usb" + _SOCKETCAN, "gs_usb"),
    "iscan": Driver("isCAN of Thorsis (iscandrv.dll)", systems="Windows"),
    "ixxat": Driver("VCI of HMS Ixxat" + _SOCKETCAN, systems="Windows"),
    "kvaser": Driver("CANlib of Kvaser" + _SOCKETCAN, "", "libcanlib.so canlib32", "Linux and Windows"),
    "neousys": Driver("WDT_DIO of Neousys", "", "libwdt_dio.so ./WDT_DIO.dll", "Linux and Windows"),
    "neovi": Driver("pip install python-ics", "ics"),
    "nican": Driver("NI-CAN", systems="Windows"),
    "nixnet": Driver("pip install nixnet", "nixnet", systems="Windows"),
    "pcan": Driver("PCAN-Basic of PEAK, PCBUSB on macOS" + _SOCKETCAN, "", "libpcanbasic.so PCANBasic libPCBUSB.dylib"),
    "robotell": _SERIAL,
    "seeedstudio": _SERIAL,
    "serial": _SERIAL,
    "slcan": _SERIAL,
    "socketcan": Driver("the kernel", systems="Linux"),
    "systec": Driver("USB-CANmodul of SYS TEC" + _SOCKETCAN, systems="Windows"),
    "udp_multicast": Driver("pip install msgpack", "msgpack"),
    "usb2can": Driver("pip install pywin32" + _SOCKETCAN, "pythoncom", systems="Windows"),
    "vector": Driver("XL Driver Library of Vector", systems="Windows"),
}
"""Other interfaces, such as those of plugins, need nothing or nothing that is known here."""


def obstacle(interface: str, system: str = platform.system()) -> str:
    """Why an interface cannot be opened on this machine, with the remedy; empty if nothing is known. It is not opened."""
    if interface not in BACKENDS:
        hint = did_you_mean(interface, BACKENDS)
        return f"not an interface of python-can{hint} (allowed: {', '.join(sorted(BACKENDS))})"
    driver = DRIVERS.get(interface)
    if driver is None:
        module, attribute = BACKENDS[interface]
        try:
            getattr(import_module(module), attribute)
        except Exception as error:  # drivers raise any exception when something of theirs is missing
            return f"the driver cannot be loaded on this machine ({type(error).__name__}: {error})"
        return ""
    if system not in (driver.systems or system):
        return f"works only on {driver.systems}, with its driver: {driver.remedy}"
    return "" if _is_installed(driver) else f"its driver is missing on this machine: {driver.remedy}"


def _is_installed(driver: Driver) -> bool:
    """Whether module or library exists; True if neither is looked for."""
    if driver.module:
        return find_spec(driver.module) is not None
    return not driver.libraries or any(map(_loads, driver.libraries.split()))


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


class CanInterfaceError(CanopenError):
    """An interface that cannot be opened: ``allowed`` says why, with the remedy."""

    def __str__(self) -> str:
        return f"{self.field}: {self.value!r} cannot be opened: {self.allowed}"


def system_text(error: OSError, channel: object, bitrate: int | None = None) -> str:
    """The system's error text for a CAN interface, with the remedy if there is a command for it."""
    text = error.strerror or str(error)
    name = channel if isinstance(channel, str) and channel else "can0"
    if error.errno == errno.ENETDOWN:
        return f"{text}; bring it up: sudo ip link set {name} up type can bitrate {bitrate or 'BITRATE'} restart-ms 100"
    if error.errno == errno.ENODEV:
        return f"{text}; list the existing ones: ip link show type can"
    if error.errno == errno.EAFNOSUPPORT:
        return f"{text}; load the kernel's CAN modules: sudo modprobe can-raw"
    return text


def open_bus(
    interface: str, channel: str | int | None = None, bitrate: int | None = None, **extra: object
) -> can.BusABC:
    """A bus of any python-can interface; ``extra`` goes to it unchanged.

    CanInterfaceError names interface and channel when the driver is missing or the channel cannot be reached.
    """
    settings: dict[str, object] = {"interface": interface, "ignore_config": True, **extra}
    if channel is not None:
        settings["channel"] = channel
    if bitrate is not None:
        settings["bitrate"] = bitrate
    try:
        return can.Bus(**settings)  # type: ignore[arg-type]
    except Exception as error:  # drivers raise any exception
        text = system_text(error, channel, bitrate) if isinstance(error, OSError) and error.errno else str(error)
        text = obstacle(interface) or text or type(error).__name__
        raise CanInterfaceError("CAN interface", f"{interface} channel {channel}", text) from error
