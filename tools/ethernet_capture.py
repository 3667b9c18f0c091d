"""Everything an Ethernet interface sends and receives, into a pcapng file with the times the kernel stamped (Linux)."""

from __future__ import annotations

import socket
import struct
import threading
import time
from pathlib import Path
from types import TracebackType
from typing import Final, Self

from pdgw.decoder.capture.pcapng_file import PcapngWriter
from pdgw.decoder.records import Link
from pdgw.gateway.errors import GatewayError

_EVERY_PROTOCOL: Final = 3
_SO_TIMESTAMPNS: Final = 35
_TIMESPEC: Final = struct.Struct("@qq")
_NS_PER_S: Final = 1_000_000_000
_BUFFER: Final = 1 << 22
_MAX_FRAME: Final = 1 << 16
_WAIT_S: Final = 0.2


class EthernetCapture:
    """Records from ``__enter__`` to ``__exit__``; GatewayError where the interface or the file cannot be had."""

    def __init__(self, interface: str, path: Path) -> None:
        try:
            self._socket = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0)
        except OSError as error:
            raise GatewayError(f"interface {interface}: cannot be recorded ({error.strerror or error})") from error
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
            self._socket.bind((interface, _EVERY_PROTOCOL))
            self._writer = PcapngWriter(path)
        except OSError as error:
            self._socket.close()
            raise GatewayError(f"interface {interface}: cannot be recorded ({error.strerror or error})") from error
        self._interface = interface
        self._socket.settimeout(_WAIT_S)
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._record, name=f"capture of {interface}", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ending.set()
        self._thread.join()
        self._socket.close()
        self._writer.close()

    def _record(self) -> None:
        while True:
            try:
                data, ancillary, _, _ = self._socket.recvmsg(_MAX_FRAME, socket.CMSG_SPACE(_TIMESPEC.size))
            except TimeoutError:
                if self._ending.is_set():
                    return
                continue
            except OSError:  # the interface is gone, as at the end of its namespace
                return
            stamps = [content for _, kind, content in ancillary if kind == _SO_TIMESTAMPNS]
            seconds, rest = _TIMESPEC.unpack(stamps[0]) if stamps else divmod(time.time_ns(), _NS_PER_S)
            self._writer.write(Link.ETHERNET, self._interface, seconds * _NS_PER_S + rest, data)
