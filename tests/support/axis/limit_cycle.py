"""Search for limit cycles: entries into Operation Enabled while the PLC sends OFF, with a late Statusword.

An axis operates and moves; the PLC sends Disable Operation or a short ON for a few frames, then only a stop, for as
long as the drive needs. A gateway that answers a Statusword older than its own command enables the drive again.
"""

from __future__ import annotations

import enum
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from pdgw.base.durations import MS, SECOND
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import State
from pdgw.gateway.axis.telegrams import DSC_TELEGRAM_NUMBERS, POSITIONER_TELEGRAM_NUMBERS, TASK_TELEGRAM_NUMBERS
from pdgw.gateway.configuration.file import parse_config
from pdgw.gateway.daemon.assembly import build_gateway
from pdgw.peers.drive import Latency, SimulatedDrive
from pdgw.peers.plc.exchange.plc import Plc
from pdgw.peers.world import World
from pdgw.profidrive.telegrams import telegram
from tests.long.soak.plan import POSITIONER

TRANSPARENT = 100
WATCHED_NS = 900 * MS
"""A Statusword of 100 ms and a quick stop from half speed are over by then, and a limit cycle has come round four times."""
_PATIENCE_NS = 20 * SECOND
_SPEED = {"NSOLL_A": 0x2000, "NSOLL_B": 0x2000_0000, "Target Velocity": 3000}
_CONFIGURATION = """\
[can]
interface = "virtual"
channel = "limit cycle"
bitrate = 1000000
[transport]
cyclic_port = 0
acyclic_port = 0
status_port = 0
watchdog_factor = 10
cycle_time_ms = {cycle_ms}
[[axis]]
do_id = 1
node_id = 1
telegram = {number}
simulate = true
on_plc_loss = "ramp"
{keys}"""
_DSC = 'dsc = "speed"\nfollowing_window = 100000\n'


class Ending(enum.Enum):
    """The stop that stays active after the short command."""

    OFF = "OFF"
    PLC_LOST = "PLC lost, on_plc_loss = ramp"
    NO_CONTROL = "STW1.10 = 0"


class Beginning(enum.Enum):
    """The short command before it."""

    DISABLE = "Disable Operation in operation"
    PULSE = "ON from OFF"


@dataclass(frozen=True, slots=True)
class Case:
    """``frames``: duration of the short command in PLC frames."""

    status_ms: int
    frames: int
    beginning: Beginning
    ending: Ending


class Site:
    """A gateway with one axis of a telegram, at one cycle time."""

    def __init__(self, number: int, cycle_ms: int) -> None:
        keys = _DSC if number in DSC_TELEGRAM_NUMBERS else POSITIONER if number in POSITIONER_TELEGRAM_NUMBERS else ""
        config = parse_config(_CONFIGURATION.format(cycle_ms=cycle_ms, number=number, keys=keys))
        self.number = number
        self.world = World(0)
        self.loop = self.world.loop
        self.world.simulate(config)
        self.daemon = build_gateway(config, self.world)
        drive = self.world.simulations["can"].device(1)
        assert isinstance(drive, SimulatedDrive)
        self.drive = drive
        port = self.world.network.open("plc", 0, "PLC")
        self.cycle_ns = cycle_ms * MS
        self.plc = Plc(self.loop, port, self.daemon.address, [telegram(number)], self.cycle_ns)
        self.word = telegram(number).setpoints.names[0]
        self.entries = 0
        self.drive.model.watchers.append(self._entered)
        self.daemon.start()
        self.plc.start()
        raw = number == TRANSPARENT
        self.off = 0x06 if raw else 0x043E if number in TASK_TELEGRAM_NUMBERS else 0x047E
        self.on = self.off | (0x0F if raw else 0x01)
        values = dict.fromkeys(telegram(number).setpoints.names, 0)
        profile = {"Profile Velocity": 6000, "Profile Acceleration": 300, "Profile Deceleration": 300}
        self.plc.set(0, values | ({"Modes of Operation": Mode.VELOCITY} | profile if raw else {}))

    def close(self) -> None:
        self.loop.close()

    def _entered(self, state: State) -> None:
        self.entries += state is State.OPERATION_ENABLED

    def _ask(self, word: int, duration: int) -> None:
        self.plc.set(0, {self.word: word})
        self.loop.run_for(duration)

    def _enable(self) -> None:
        """Acknowledge, OFF and ON until the drive operates; half of the speed where the telegram has one."""
        end = self.loop.now() + _PATIENCE_NS
        steps = (self.off | 0x07, self.on) if self.number == TRANSPARENT else (self.on,)
        while self.drive.model.state is not State.OPERATION_ENABLED:
            assert self.loop.now() < end, self.daemon.axes[0].drive.status_text
            for word in (self.off | 0x80, self.off, *steps):
                self._ask(word, 4 * self.cycle_ns + 100 * MS)
        self.plc.set(0, {name: value for name, value in _SPEED.items() if name in self.plc.endpoint.setpoints[0]})
        self.loop.run_for(200 * MS)

    def entries_under_off(self, case: Case) -> int:
        """Number of entries to operation during an active stop."""
        self.plc.silent = False
        self.drive.model.latency = Latency()
        self._enable()
        self.drive.model.latency = Latency(status_ms=case.status_ms)
        self.loop.run_for(2 * self.cycle_ns + case.status_ms * MS)
        if case.beginning is Beginning.DISABLE:
            short = self.on & ~0x08
        else:
            self._ask(self.off, 10 * MS)
            self.loop.until(lambda: self.drive.model.state is State.READY_TO_SWITCH_ON, "OFF", _PATIENCE_NS)
            self.loop.run_for(2 * self.cycle_ns + case.status_ms * MS)
            short = self.on
        self._ask(short, case.frames * self.cycle_ns)
        self.plc.silent = case.ending is Ending.PLC_LOST
        # The Controlword of telegram 100 has no bit for the control by the PLC.
        standing = short & ~0x0400 if case.ending is Ending.NO_CONTROL and self.number != TRANSPARENT else self.off
        self._ask(standing, 2 * self.cycle_ns + 2 * MS)
        if case.ending is Ending.PLC_LOST:
            self.loop.run_for(10 * self.cycle_ns)
        before = self.entries
        self.loop.run_for(WATCHED_NS)
        return self.entries - before


def cases(delays: Sequence[int], cycle_ms: int) -> Iterator[Case]:
    """Each delay with each beginning and ending; the frames of the short command change from case to case."""
    turn = 0
    for delay in delays:
        lengths = (1, 3, delay // cycle_ms + 1, 2 * (delay // cycle_ms) + 2)
        for beginning in Beginning:
            for ending in Ending:
                yield Case(delay, lengths[turn % len(lengths)], beginning, ending)
                turn += 1


def search(number: int, cycle_ms: int, delays: Sequence[int]) -> list[tuple[Case, int]]:
    """The cases in which the drive enters operation under a standing stop, with how often."""
    site = Site(number, cycle_ms)
    try:
        counted = [(case, site.entries_under_off(case)) for case in cases(delays, cycle_ms)]
    finally:
        site.close()
    return [(case, entries) for case, entries in counted if entries]
