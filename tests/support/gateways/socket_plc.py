"""A PLC on the machine's own clock and sockets, for gateways that are processes or threads."""

from __future__ import annotations

from collections.abc import Callable

from pdgw.base.durations import MS
from pdgw.ds301.loop.system_loop import SystemLoop
from pdgw.gateway.base.udp import Address, UdpSocket
from pdgw.peers.plc.exchange.plc import Plc
from pdgw.profidrive.telegrams import telegram
from tests.support.buses import PATIENCE_S, check_processes
from tests.support.gateways.fault_display import drive_state

OFF = 0x047E
CYCLE = 20 * MS
"""As long as the gateways' own or shorter: each frame costs both processes a part of a millisecond."""
_READY, _OPERATION = 0x01, 0x07
"""ZSW1.0 to 3 and 6."""
_ENABLING = (_READY, 0x03, _OPERATION)


class SocketPlc(Plc):
    """The least a PLC has to do."""

    def __init__(self, address: Address, numbers: list[int]) -> None:
        loop = SystemLoop()
        port = UdpSocket(loop, "127.0.0.1", 0, "PLC")
        super().__init__(loop, port, address, [telegram(number) for number in numbers], CYCLE)

    def cycle(self) -> None:
        check_processes()
        super().cycle()

    def until(self, condition: Callable[[], object], what: str, seconds: float = PATIENCE_S) -> None:
        super().until(condition, what, seconds)

    def seen(self) -> str:
        return f"{super().seen()}, counted: {dict(self.endpoint.counters)}"

    def enable(self, axis: int) -> None:
        """OFF, then ON; again if the drive or the PLC was lost meanwhile, as on a busy machine: that needs a new OFF."""
        first = next(iter(self.endpoint.setpoints[axis]))
        off = 0x043E if self.endpoint.telegrams[axis].number == 9 else OFF

        def state() -> int:
            return drive_state(self.value("ZSW1", axis))

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
            self.cycle()
            actuals = self.endpoint.actuals[axis]
            assert actuals is None or not actuals["ZSW1"] & 0x04, "started by a standing ON"
