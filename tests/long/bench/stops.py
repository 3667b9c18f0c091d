"""Time until a drive gets its stop: from each loss to the first stop Controlword on the CAN bus.

Virtual time (``VIRTUAL``): a gateway with default timeouts, a turning drive, and the loss at a random time of the cycle.
When the gateway itself is killed or paused, it can send nothing. Then the drive's own guarding is measured, in real time,
between processes on a loopback bus (``processes``).
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from random import Random

from pdgw.ds301.connection_set import NMT
from pdgw.ds301.nmt import NmtCommand
from pdgw.ds301.pdo import PdoDirection
from pdgw.dsp402.drive.settings import DriveSettings
from pdgw.dsp402.states import Command, State
from pdgw.durations import MS, SECOND
from pdgw.gateway.assembly import build_gateway
from pdgw.gateway.configuration.file import parse_config
from pdgw.gateway.errors import GatewayError
from pdgw.peers.drive import SimulatedDrive
from pdgw.peers.plc.exchange.cycling import CyclingPlc
from pdgw.peers.world import World
from pdgw.peers.world.can_bus import Member
from pdgw.profidrive.telegrams import telegram
from tests.long.bench.measuring.measure import percentile

CHANNEL, NODE = "stops", 1
CONFIGURATION = f"""
[can]
interface = "virtual"
channel = "{CHANNEL}"
[transport]
cyclic_port = 0
acyclic_port = 0
status_port = 0
[[axis]]
do_id = 1
node_id = {NODE}
telegram = 1
simulate = true
"""
"""All timeouts have their defaults."""
OFF, ON, SPEED = 0x047E, 0x047F, 0x4000
CONTROL = PdoDirection.RPDO.cob_id(1, NODE)
_STOPS = (Command.QUICK_STOP, Command.DISABLE_VOLTAGE, Command.SHUTDOWN)
_OUTAGE_NS = 250 * MS
"""Longer than the timeout of TPDOs, shorter than the drive's own guarding: the drive turns until it gets a stop."""


@dataclass
class Stop:
    """One row: the event, the start and end of the measured time, its bound and the reason of the bound."""

    cause: str
    measured: str
    bound_ms: float
    bound: str
    clock: str
    times_ns: list[int] = field(default_factory=list)

    def milliseconds(self, share: float) -> float:
        """A percentile, 0 to 1."""
        return percentile(sorted(self.times_ns), share) / MS

    @property
    def kept(self) -> bool:
        """Whether every time was below the bound."""
        return max(self.times_ns) <= self.bound_ms * MS

    def document(self) -> dict[str, object]:
        """Plain data, times in milliseconds."""
        return {
            "cause": self.cause,
            "measured": self.measured,
            "clock": self.clock,
            "samples": len(self.times_ns),
            "p50_ms": self.milliseconds(0.5),
            "p99_ms": self.milliseconds(0.99),
            "max_ms": self.milliseconds(1),
            "bound_ms": self.bound_ms,
            "bound": self.bound,
            "kept": self.kept,
        }


def is_stop(data: bytes) -> bool:
    """Whether the last object of this RPDO 1 is a Controlword that removes the enable."""
    word = int.from_bytes(data[-2:], "little")
    return any(command.matches(word) for command in _STOPS)


class Site:
    """A gateway with one turning axis, its PLC, and the recorded frames of the bus."""

    def __init__(self, seed: int) -> None:
        self.world = World(seed)
        self.chance = Random(seed)
        config = parse_config(CONFIGURATION)
        self.world.simulate(config)
        self.daemon = build_gateway(config, self.world)
        self.loop = self.world.loop
        self.frames: list[tuple[int, int, bytes]] = []
        """Time, identifier and data of every frame that the gateway sent on the bus."""
        self.bus = self.world.bus(CHANNEL)
        self.bus.taps.append(self._note)
        port = self.world.network.open("plc", 0, "PLC")
        self.plc = CyclingPlc(self.loop, port, self.daemon.address, [telegram(1)], self.daemon.cycle_ns)
        self.plc.before_frame.append(self._sends)
        self.last_sent = 0
        """Send time of the PLC's last frame."""

    def _note(self, now: int, sender: Member, can_id: int, data: bytes) -> None:
        if sender.name == "gateway":
            self.frames.append((now, can_id, data))

    def _sends(self, now: int) -> None:
        if not self.plc.silent:
            self.last_sent = now

    @property
    def drive(self) -> SimulatedDrive:
        """The drive of the axis."""
        device = self.world.simulations["can"].device(NODE)
        assert isinstance(device, SimulatedDrive)
        return device

    @contextmanager
    def running(self) -> Iterator[None]:
        """Run the gateway and its PLC until the block ends."""
        self.daemon.start()
        self.plc.start()
        try:
            yield
        finally:
            self.daemon.stop()
            with contextlib.suppress(TimeoutError):
                self.loop.until(self.daemon.stopped.is_set, "the end", 30 * SECOND)
            self.loop.close()

    def turn(self) -> None:
        """OFF, ON, full speed, then a random time."""
        axis, model = self.daemon.axes[0], self.drive.model
        self.plc.set({"STW1": OFF, "NSOLL_A": SPEED})
        self.until(lambda: axis.good and axis.released and axis.machine.outputs.reason is not None, "the axis is off")
        self.plc.set({"STW1": ON})
        self.until(lambda: model.state is State.OPERATION_ENABLED, "operation")
        self.loop.run_for(2 * SECOND + self.chance.randrange(200 * MS))
        self.frames.clear()

    def until(self, condition: Callable[[], object], what: str) -> None:
        """Wait for a condition; GatewayError when it does not become true."""
        try:
            self.loop.until(condition, what, 60 * SECOND)
        except TimeoutError as error:
            raise GatewayError(f"benchmark of stops: {error}") from error

    def first(self, wanted: Callable[[int, bytes], bool]) -> int:
        """Run until the gateway has sent such a frame. Return the time of its end."""
        position = 0
        found = -1

        def came() -> bool:
            nonlocal position, found
            while position < len(self.frames) and found < 0:
                now, can_id, data = self.frames[position]
                position += 1
                if wanted(can_id, data):
                    found = now
            return found >= 0

        self.until(came, "the stop on the bus")
        return found

    def stop_frame(self) -> int:
        """Time of the end of the first stop Controlword."""
        return self.first(lambda can_id, data: can_id == CONTROL and is_stop(data))

    def off(self) -> None:
        """Run until the drive is at standstill without power."""
        model = self.drive.model
        self.until(lambda: model.velocity_actual == 0 and model.state is not State.OPERATION_ENABLED, "standstill")
        self.loop.run_for(SECOND)

    # -- the losses ---------------------------------------------------------------------------------------------------

    def plc_lost(self) -> int:
        """The PLC stops sending."""
        self.plc.silent = True
        begin = self.last_sent
        return self.stop_frame() - begin

    def _from_fault(self, name: str, **values: int) -> int:
        """Measure from the time at which the drive gets a fault of its catalogue."""
        begin = self.loop.now()
        self.drive.do(lambda node: node.misbehave(name, **values))
        took = self.stop_frame() - begin
        self.drive.do(lambda node: node.behave())
        return took

    def tpdos_lost(self) -> int:
        """No PDO reaches or leaves the drive any more."""
        return self._from_fault("lost-pdos", every=1)

    def heartbeat_lost(self) -> int:
        """The drive's heartbeat stops."""
        return self._from_fault("heartbeat-stops")

    def bus_back(self) -> int:
        """The gateway's bus connection is cut and restored. Measured from the first time at which a frame can pass."""
        self.world.gateway_port(CHANNEL).connect(connected=False)
        self.loop.run_for(_OUTAGE_NS)
        self.frames.clear()
        begin = self.loop.now()
        self.world.gateway_port(CHANNEL).connect(connected=True)
        return self.stop_frame() - begin

    def bus_lost(self) -> int:
        """The bus connection is cut permanently. Measured until the drive brakes by its own guarding."""
        begin = self.loop.now()
        model = self.drive.model
        self.world.gateway_port(CHANNEL).connect(connected=False)
        self.until(lambda: model.state is not State.OPERATION_ENABLED, "the drive's own stop")
        took = self.loop.now() - begin
        self.world.gateway_port(CHANNEL).connect(connected=True)
        return took

    def deaf(self) -> int:
        """The drive ignores RPDOs and the PLC commands OFF3. Measured from the first stop Controlword to NMT Stop."""
        self.drive.do(lambda node: node.misbehave("deaf"))
        self.plc.set({"STW1": ON & ~0x4})
        begin = self.stop_frame()
        took = self.first(lambda can_id, data: can_id == NMT and data[0] == NmtCommand.STOP) - begin
        self.drive.do(lambda node: node.behave())
        return took


_TRANSPORT = parse_config(CONFIGURATION).transport
_CYCLE, _WATCHDOG = round(_TRANSPORT.cycle_time_ms), _TRANSPORT.watchdog_factor
_NODE = DriveSettings(NODE)
_EVENT, _EVENTS = _NODE.tpdo_event_ms, _NODE.tpdo_timeout_factor
_HEARTBEAT, _HEARTBEATS = _NODE.heartbeat_ms, _NODE.heartbeat_factor
_REFRESH = _NODE.rpdo_refresh_ms
_LOOK = 20
"""Interval in which the node's task checks for a missing heartbeat, in milliseconds."""
_FRAME = 1
"""Delay by other frames on the bus, in milliseconds."""
_STOP_ON_CAN = "the first stop Controlword on CAN"
_TPDOS = f"{_EVENTS} x {_EVENT} ms without a TPDO + a cycle + frames"
_BEATS = f"{_HEARTBEATS} x {_HEARTBEAT} ms without a heartbeat"
VIRTUAL: tuple[tuple[Stop, Callable[[Site], int]], ...] = (
    (
        Stop(
            "PLC lost",
            f"its last frame to {_STOP_ON_CAN}",
            _WATCHDOG * _CYCLE + _CYCLE + _FRAME,
            f"watchdog of {_WATCHDOG} x {_CYCLE} ms + a cycle + frames",
            "virtual",
        ),
        Site.plc_lost,
    ),
    (
        Stop(
            "drive lost: no PDO passes",
            f"the loss to {_STOP_ON_CAN}",
            _EVENTS * _EVENT + _CYCLE + _FRAME,
            _TPDOS,
            "virtual",
        ),
        Site.tpdos_lost,
    ),
    (
        Stop(
            "drive lost: no heartbeat",
            f"the loss to {_STOP_ON_CAN}",
            _HEARTBEATS * _HEARTBEAT + _LOOK + _CYCLE + _FRAME,
            f"{_BEATS} + {_LOOK} ms + a cycle + frames",
            "virtual",
        ),
        Site.heartbeat_lost,
    ),
    (
        Stop(
            f"bus lost for {_OUTAGE_NS // MS} ms",
            f"the first moment a frame can pass to {_STOP_ON_CAN}",
            2 * _REFRESH,
            f"two refreshes of {_REFRESH} ms",
            "virtual",
        ),
        Site.bus_back,
    ),
    (
        Stop(
            "bus lost for good",
            "the loss to the drive's own stop (1016h, 6007h)",
            _HEARTBEATS * _HEARTBEAT + _FRAME,
            f"{_BEATS} of the gateway",
            "virtual",
        ),
        Site.bus_lost,
    ),
    (
        Stop(
            "deaf drive",
            "the first stop Controlword to NMT Stop on CAN",
            2 * (_REFRESH + _EVENT + _CYCLE) + _CYCLE + _FRAME,
            f"twice {_REFRESH} ms refresh + {_EVENT} ms event timer + a cycle, + a cycle + frames",
            "virtual",
        ),
        Site.deaf,
    ),
)
"""The rows in virtual time, each with the function that measures one time."""


def virtual(trials: int) -> Iterator[Stop]:
    """Each row with this number of losses, each in a world of its own. The random times are the same in each run."""
    for row, loss in VIRTUAL:
        measured = replace(row, times_ns=[])
        for seed in range(trials):
            site = Site(seed)
            with site.running():
                site.turn()
                measured.times_ns.append(loss(site))
                site.off()
        yield measured
