"""Time until a drive gets its stop, from each loss to the first stop Controlword on the CAN bus, in virtual time.

A gateway with default timeouts and a turning drive has the loss at a random time of the cycle. The same bounds are in
docs/safety.md.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.communication import NMT, NmtCommand
from pdgw.ds301.pdo import PdoDirection
from pdgw.dsp402.drive.settings import DriveSettings
from pdgw.dsp402.states import Command, State
from pdgw.gateway.axis.settings import AxisSettings
from pdgw.gateway.configuration.file import parse_config
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.peers.plc.exchange.plc import Plc
from pdgw.peers.world.can_bus import Member
from pdgw.profidrive.telegrams import telegram
from tests.support.gateways.daemon import drive_of, running, world_of

TITLES = ("what is lost", "from ... to", "p50", "max", "bound")
_CHANNEL, _NODE = "stops", 1
_CONFIGURATION = parse_config(f"""
[can]
interface = "virtual"
channel = "{_CHANNEL}"
[transport]
cyclic_port = 0
acyclic_port = 0
status_port = 0
[[axis]]
do_id = 1
node_id = {_NODE}
telegram = 1
simulate = true
""")
_OFF, _ON, _SPEED = 0x047E, 0x047F, 0x4000
_CONTROL = PdoDirection.RPDO.cob_id(1, _NODE)
_STOPS = (Command.QUICK_STOP, Command.DISABLE_VOLTAGE, Command.SHUTDOWN)
_OUTAGE_NS = 250 * MS
"""Longer than the timeout of TPDOs, shorter than the drive's own guarding: the drive turns until it gets a stop."""
_PATIENCE_NS = 60 * SECOND


class Site:
    """A gateway with one turning axis, its PLC, and the frames of the gateway on the bus."""

    def __init__(self, daemon: Daemon) -> None:
        world = world_of(daemon)
        self.loop = world.loop
        self.drive = drive_of(daemon, _NODE)
        self.last_sent = 0
        """Send time of the PLC's last frame."""
        self.plc = Plc(self.loop, world.network.open("plc", 0, "PLC"), daemon.address, [telegram(1)], daemon.cycle_ns)
        self.plc.before_frame.append(self._sends)
        self._frames: list[tuple[int, int, bytes]] = []
        world.bus(_CHANNEL).taps.append(self._note)
        self.plc.start()
        self.plc.set(0, {"STW1": _OFF, "NSOLL_A": _SPEED})
        axis = daemon.axes[0]
        self.until(lambda: axis.good and axis.released and axis.machine.outputs.reason is not None)
        self.plc.set(0, {"STW1": _ON})
        self.until(lambda: self.drive.model.state is State.OPERATION_ENABLED)
        self.loop.run_for(2 * SECOND + world.chance("loss").randrange(200 * MS))
        self._frames.clear()
        self.connect = world.gateway_port(_CHANNEL).connect

    def _note(self, now: int, sender: Member, can_id: int, data: bytes) -> None:
        if sender.name == "gateway":
            self._frames.append((now, can_id, data))

    def _sends(self, now: int) -> None:
        if not self.plc.silent:
            self.last_sent = now

    def until(self, condition: Callable[[], object]) -> None:
        """Run until a condition is true; TimeoutError after a minute."""
        self.loop.until(condition, "the stop", _PATIENCE_NS)

    def first(self, matches: Callable[[int, bytes], bool]) -> int:
        """Run until the gateway has sent such a frame from now on. Return the time of its end."""
        self._frames.clear()
        self.until(lambda: any(matches(can_id, data) for _, can_id, data in self._frames))
        return next(now for now, can_id, data in self._frames if matches(can_id, data))

    def stop_frame(self) -> int:
        """Time of the end of the next stop Controlword."""
        return self.first(lambda can_id, data: can_id == _CONTROL and _is_stop(data))


def _is_stop(data: bytes) -> bool:
    """Whether the last object of this RPDO 1 is a Controlword that removes the enable."""
    return any(command.matches(_word(data)) for command in _STOPS)


def _word(data: bytes) -> int:
    return int.from_bytes(data[-2:], "little")


def _lose_plc(site: Site) -> int:
    site.plc.silent = True
    begin = site.last_sent
    return site.stop_frame() - begin


def _lose(site: Site, fault: str, **values: int) -> int:
    begin = site.loop.now()
    site.drive.do(lambda node: node.start_fault(fault, **values))
    return site.stop_frame() - begin


def _interrupt_bus(site: Site) -> int:
    site.connect(connected=False)
    site.loop.run_for(_OUTAGE_NS)
    begin = site.loop.now()
    site.connect(connected=True)
    return site.stop_frame() - begin


def _lose_bus(site: Site) -> int:
    begin = site.loop.now()
    site.connect(connected=False)
    site.until(lambda: site.drive.model.state is not State.OPERATION_ENABLED)
    return site.loop.now() - begin


def _ignore_stop(site: Site) -> int:
    site.drive.do(lambda node: node.start_fault("deaf"))
    site.plc.set(0, {"STW1": _ON & ~0x4})
    begin = site.stop_frame()
    return site.first(lambda can_id, data: can_id == NMT and data[0] == NmtCommand.STOP) - begin


def _ignore_stop_at_standstill(site: Site) -> int:
    site.plc.set(0, {"NSOLL_A": 0})
    site.until(lambda: site.drive.model.ramp.speed == 0)
    site.loop.run_for(SECOND)
    return _ignore_stop(site)


def _ignore_disable_operation(site: Site) -> int:
    site.drive.do(lambda node: node.start_fault("deaf"))
    site.plc.set(0, {"STW1": _ON & ~0x8})
    begin = site.first(lambda can_id, data: can_id == _CONTROL and Command.SWITCH_ON.matches(_word(data)))
    return site.stop_frame() - begin


class Loss(NamedTuple):
    """A row of the table."""

    cause: str
    measured: str
    measure: Callable[[Site], int]
    bound_ms: float


_CYCLE = round(_CONFIGURATION.transport.cycle_time_ms)
_FRAME = 1
"""Delay by other frames on the bus, in milliseconds."""
_LOOK = 20
"""Interval in which the node's task checks for a missing heartbeat, in milliseconds."""
_SETTINGS = DriveSettings(_NODE)
_BEATS = _SETTINGS.heartbeat_factor * _SETTINGS.heartbeat_ms
_TPDOS = _SETTINGS.tpdo_timeout_factor * _SETTINGS.tpdo_event_ms
_REACTION = 2 * (_SETTINGS.rpdo_refresh_ms + _SETTINGS.tpdo_event_ms + _CYCLE)
_JERK = AxisSettings().stop_time_ns / MS / 7
_TO_STOP = "the loss to the first stop Controlword on CAN"
LOSSES = (
    Loss(
        "PLC",
        "its last frame to the first stop Controlword on CAN",
        _lose_plc,
        (_CONFIGURATION.transport.watchdog_factor + 1) * _CYCLE + _FRAME,
    ),
    Loss("TPDOs of the drive", _TO_STOP, lambda site: _lose(site, "lost-pdos", every=1), _TPDOS + _CYCLE + _FRAME),
    Loss(
        "heartbeat of the drive",
        _TO_STOP,
        lambda site: _lose(site, "heartbeat-stops"),
        _BEATS + _LOOK + _CYCLE + _FRAME,
    ),
    Loss(
        f"bus, for {_OUTAGE_NS // MS} ms",
        "the first moment a frame can pass to the first stop Controlword on CAN",
        _interrupt_bus,
        2 * _SETTINGS.rpdo_refresh_ms,
    ),
    Loss("bus", "the loss to the drive's own stop (1016h, 6007h)", _lose_bus, _BEATS + _FRAME),
    Loss(
        "RPDOs of the drive",
        "the first stop Controlword to NMT Stop on CAN",
        _ignore_stop,
        _REACTION + _CYCLE + _FRAME,
    ),
    Loss(
        "RPDOs of the drive, at standstill",
        "the first stop Controlword to NMT Stop on CAN",
        _ignore_stop_at_standstill,
        AxisSettings().enter_ns / MS + _CYCLE + _FRAME,
    ),
    Loss(
        "RPDOs of the drive, STW1.3 = 0",
        "Disable Operation to Quick Stop on CAN",
        _ignore_disable_operation,
        _REACTION + _JERK + 2 * _CYCLE + _FRAME,
    ),
)


def measure(loss: Loss, seed: int) -> int:
    """The time of one loss in nanoseconds. The seed sets its time in the cycle."""
    with running(_CONFIGURATION, seed=seed) as daemon:
        return loss.measure(Site(daemon))


def rows(trials: int) -> Iterator[tuple[str, ...]]:
    """The lines of the table."""
    for loss in LOSSES:
        times = sorted(measure(loss, seed) / MS for seed in range(trials))
        values = f"{times[trials // 2]:.1f} ms", f"{times[-1]:.1f} ms", f"{loss.bound_ms:.0f} ms"
        yield (loss.cause, loss.measured, *values)
