"""A PLC on the machine's own clock and sockets, for gateways that are processes or threads."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable

from pdgw.durations import MS
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.profidrive.telegrams import telegram
from tests.support.buses import PATIENCE_S, check_processes
from tests.support.gateways.fault_display import drive_state

OFF = 0x047E
CYCLE = 20 * MS
"""As long as the gateways' own or shorter: each frame costs both processes a part of a millisecond."""
_READY, _OPERATION = 0x01, 0x07
"""ZSW1.0 to 3 and 6."""
_ENABLING = (_READY, 0x03, _OPERATION)


class SocketPlc:
    """The least a PLC has to do."""

    def __init__(self, address: tuple[str, int], numbers: list[int]) -> None:
        self.endpoint = PlcEndpoint([telegram(number) for number in numbers], CYCLE)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect(address)
        self.socket.settimeout(CYCLE / 1e9)

    def exchange(self) -> None:
        try:
            self.socket.send(self.endpoint.build(time.monotonic_ns()))
            while True:
                self.endpoint.receive(self.socket.recv(2048))
        except (TimeoutError, ConnectionRefusedError):
            return

    def until(self, condition: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            check_processes()
            assert time.monotonic() < deadline, (
                f"{what}: {self.endpoint.actuals}, counted: {dict(self.endpoint.counters)}"
            )
            self.exchange()

    def signal(self, axis: int, name: str) -> int:
        actuals = self.endpoint.actuals[axis]
        return -1 if actuals is None else actuals[name]

    def enable(self, axis: int) -> None:
        """OFF, then ON; again if the drive or the PLC was lost meanwhile, as on a busy machine: that needs a new OFF."""
        first = next(iter(self.endpoint.setpoints[axis]))
        off = 0x043E if self.endpoint.telegrams[axis].number == 9 else OFF

        def state() -> int:
            return drive_state(self.signal(axis, "ZSW1"))

        def operates() -> bool:
            if state() not in _ENABLING:
                self.endpoint.set(axis, {first: off})
            elif state() == _READY:
                self.endpoint.set(axis, {first: off | 1})
            return state() == _OPERATION

        self.endpoint.set(axis, {first: off})
        self.until(lambda: state() == _READY, "ready")
        self.until(operates, "operation")

    def stays_off(self, axis: int) -> None:
        """The ON that stays active must not start it. On a busy machine its drive may be lost meanwhile."""
        for _ in range(20):
            self.exchange()
            actuals = self.endpoint.actuals[axis]
            assert actuals is None or not actuals["ZSW1"] & 0x04, "started by a standing ON"
