"""A gateway on real interfaces, simulated drives on the wire, a PLC and the sequence of a test in one loop, see ``unhurried``."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.bus.interfaces import open_bus
from pdgw.gateway.base.udp import UdpSocket
from pdgw.gateway.configuration.file import parse_config
from pdgw.gateway.daemon.assembly import build_gateway
from pdgw.gateway.service.status import snapshot
from pdgw.peers.drive import ENGEL, Shape, SimulatedDrive
from pdgw.peers.plc.exchange.plc import Plc
from pdgw.profidrive.telegrams import telegram
from tests.can.unhurried import UnhurriedPlatform
from tests.support.buses import PATIENCE_S
from tests.support.gateways.fault_display import drive_state

T = TypeVar("T")
CYCLE_MS = 20
OFF, ON = 0x047E, 0x047F
INHIBITED, READY, OPERATION = 0x40, 0x01, 0x07
"""State bits of ZSW1."""
HALF = 0x2000
"""50 % of NSOLL and NIST."""
_LOOK_NS = 10 * MS
_TIMES = "heartbeat_ms = 700\ntpdo_event_ms = 2000\nsdo_timeout_ms = 5000\n"


def can_table(channel: str, more: str = "") -> str:
    return f'[[can]]\nname = "{channel}"\ninterface = "socketcan"\nchannel = "{channel}"\nbitrate = 1000000\n{more}'


def axis_table(number: int, channel: str) -> str:
    """Times that a loaded machine keeps: what is guarded here is the wire."""
    return f'[[axis]]\ndo_id = {number}\nnode_id = {number}\ntelegram = 1\ncan = "{channel}"\n{_TIMES}'


class Plant:
    """``tables``: the buses and axes of the configuration; ``plc``: the PLC's address; ``listen``: further keys of the transport.
    ``run_steps`` runs the steps of a test while the gateway runs."""

    def __init__(self, *tables: str, plc: str = "127.0.0.1", listen: str = "watchdog_factor = 100\n") -> None:
        transport = f"cyclic_port = 0\nacyclic_port = 0\nstatus_port = 0\ncycle_time_ms = {CYCLE_MS}\n{listen}"
        self.config = parse_config("\n".join((*tables, f"[transport]\n{transport}")))
        self.daemon = build_gateway(self.config, UnhurriedPlatform())
        self.loop = self.daemon.loop
        port = UdpSocket(self.loop, plc, 0, "PLC")
        self.plc = Plc(self.loop, port, self.daemon.address, [telegram(1)] * len(self.config.axis), CYCLE_MS * MS)
        self._drives: list[SimulatedDrive] = []

    # -- around the gateway -----------------------------------------------------------------------------------------------

    def drive(self, channel: str, node_id: int = 1, shape: Shape = ENGEL) -> SimulatedDrive:
        """Power a drive on."""
        drive = SimulatedDrive(open_bus("socketcan", channel), node_id, shape=shape, loop=self.loop)
        self._drives.append(drive)
        drive.start()
        return drive

    def outside(self, action: Callable[[], T]) -> T:
        """Run something slow, such as a command, while the gateway keeps running."""
        return self.loop.result(self.loop.offload(action))

    def run_steps(self, sequence: Callable[[], None]) -> None:
        """Run a test sequence to its end and raise its exception here. Then stop the gateway in order."""
        loop = self.loop
        outcome: list[BaseException | None] = []

        def run() -> None:
            try:
                sequence()
                outcome.append(None)
            except Exception as error:  # the test's
                outcome.append(error)
            self.daemon.stop()

        try:
            self.daemon.start()
            self.plc.start()
            loop.spawn(run, "story")
            loop.run()
            assert loop.task_errors == 0
        finally:
            self.daemon.release()
            for drive in self._drives:
                drive.stop()
            self.plc.stop()
            loop.close()
        assert outcome, f"the gateway ended before the story: {self.daemon.failure}"
        if outcome[0] is not None:
            raise outcome[0]

    # -- inside the sequence ----------------------------------------------------------------------------------------------

    def until(self, condition: Callable[[], object], what: str, seconds: float = PATIENCE_S) -> None:
        end = self.loop.now() + int(seconds * SECOND)
        while not condition():
            assert self.loop.now() < end, f"not within {seconds:g} s: {what}; {snapshot(self.daemon)}"
            self.loop.sleep(_LOOK_NS)

    def stays(self, condition: Callable[[], object], what: str, seconds: float = 1) -> None:
        end = self.loop.now() + int(seconds * SECOND)
        while self.loop.now() < end:
            assert condition(), f"{what}; {snapshot(self.daemon)}"
            self.loop.sleep(_LOOK_NS)

    def state(self, axis: int = 0) -> int:
        return drive_state(self.plc.value("ZSW1", axis))

    def command(self, word: int, speed: int = 0, axis: int = 0) -> None:
        self.plc.set(axis, {"STW1": word, "NSOLL_A": speed})

    def turn(self, axis: int = 0) -> None:
        """OFF, ON, half speed."""
        self.command(OFF, axis=axis)
        self.until(lambda: self.state(axis) == READY, "ready")
        self.command(ON, axis=axis)
        self.until(lambda: self.state(axis) == OPERATION, "operation")
        self.command(ON, HALF, axis)
        self.until(lambda: self.turns(axis), "half speed")

    def turns(self, axis: int = 0) -> bool:
        return self.plc.value("NIST_A", axis) == HALF

    def counter(self, part: str, name: str) -> int:
        """A counter of the gateway."""
        return next(
            int(item["value"]) for item in self.loop.counters.values() if (item["part"], item["name"]) == (part, name)
        )
