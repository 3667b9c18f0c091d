"""MAC addresses of stations, from DCP and Connect."""

from __future__ import annotations

from typing import Final

_STATIONS_MAX: Final = 4096


class StationNames:
    """Names of station by MAC address."""

    def __init__(self) -> None:
        self._names: dict[bytes, str] = {}

    def learn(self, mac: bytes, name: str) -> None:
        """A station has reported its name, or has received one."""
        if mac in self._names or len(self._names) < _STATIONS_MAX:
            self._names[mac] = name

    def of(self, mac: bytes) -> str:
        """The name; empty where it is not known."""
        return self._names.get(mac, "")

    def shown(self, mac: bytes) -> str:
        """Name or MAC address, for the reader."""
        return self.of(mac) or mac.hex(":")
