"""One part of a soaked day: a gateway in its world, a PLC that asks at random, troubles, and calm in which all must come back."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from random import Random

from pdgw.ds301.node import NodeStatus
from pdgw.ds301.pdo import PdoDirection
from pdgw.dsp402.states import Command, State
from pdgw.durations import MS, SECOND
from pdgw.gateway.axis.telegrams import DSC_TELEGRAM_NUMBERS, POSITIONER_TELEGRAM_NUMBERS
from pdgw.gateway.config import GatewayConfig
from pdgw.gateway.config_file import parse_config
from pdgw.gateway.daemon import Daemon
from pdgw.gateway.transport.udp import Address
from pdgw.peers.drive import SimulatedDrive
from pdgw.peers.plc.cycling import CyclingPlc
from pdgw.peers.world import Member, SimulatedCan, World
from pdgw.profidrive.frame import STATUS_RUN
from pdgw.profidrive.telegrams import telegram
from pdgw.tools.soak.trace import Trace
from pdgw.tools.soak.troubles import GATEWAY_HOST, PLC_HOST, TROUBLES, Trouble, Undo
from pdgw.tools.soak.watch import SETTLED_NS, SoakAxis, ViolationError
from pdgw.tools.soak.words import ACKNOWLEDGE, TRANSPARENT, Words

PART_NS = 600 * SECOND
"""A day is played in parts that begin with power-on, so that a moment of it is reached again soon."""
CYCLE_MS = 16
_BUS = "soak"
_CHECK_NS = 20 * MS
_RPDO1 = PdoDirection.RPDO.bases[0]
_ENABLE_MASK, _ENABLE = Command.ENABLE_OPERATION.value
_STATUS_OFFSET = -2
"""The data status of a frame, from its end."""
_BACK_NS = 20 * SECOND
"""Without troubles every axis operates again within this time."""
_OBEY_NS = 250 * MS
"""So long an axis has for a word before the next is given."""
_TALK_NS, _PAUSE_NS = 250 * MS, 600 * MS
"""Mean time between two words of the PLC, and between two troubles."""
_SHORTEST_NS, _LONGEST_NS = 2 * MS, 3 * SECOND
_CHAOS_S = (5, 30)
_TIMERS_MAX = 2000
_RUNNING_STATE = 0x4F
_POSITIONER = """\
[axis.positioner]
lu_per_revolution = 10000
max_velocity = 30000
max_acceleration = 2000
max_deceleration = 2000
position_window = 20
"""


class Life:
    """Plays from ``part`` x ``PART_NS`` on; ``numbers``: the telegrams of the axes."""

    def __init__(self, seed: int, part: int, numbers: Sequence[int], *, frames: bool = False) -> None:
        self.begin = part * PART_NS
        self.world = World(f"{seed} {part}", self.begin)
        self.loop = self.world.loop
        self.trace = Trace(self.loop.now, frames=frames)
        self.calm = True
        config = _configuration(numbers)
        self.world.simulate(config)
        self.daemon = Daemon(config, self.world)
        self._cycle_ns = self.daemon.cycle_ns
        self._watchdog_ns = self._cycle_ns * config.transport.watchdog_factor
        telegrams = [telegram(number) for number in numbers]
        port = self.world.network.open(PLC_HOST, 0, "PLC")
        self.plc = CyclingPlc(self.loop, port, self.daemon.address, telegrams, self._cycle_ns)
        self.axes = [
            self._axis(index, Words(item, self.world.chance(f"words {index}"))) for index, item in enumerate(telegrams)
        ]
        self._chance = self.world.chance("troubles")
        self._active: dict[str, tuple[Trouble, SoakAxis, Undo]] = {}
        self._quiet_since = self.begin
        self._arrived = self.begin
        self._runs = False
        self._violation: ViolationError | None = None
        self.plc.before_frame.append(self._before_frame)
        self.world.network.arrivals.append(self._on_arrival)
        self.bus.offered.append(self._on_offered)
        if frames:
            self.bus.taps.append(self._note_frame)

    def _axis(self, index: int, words: Words) -> SoakAxis:
        drive = self.world.simulations["can"].device(index + 1)
        assert isinstance(drive, SimulatedDrive)
        assert isinstance(drive.port, Member)
        self.plc.endpoint.setpoints[index] = words.values
        axis = SoakAxis(index, drive, drive.port, words, self._watchdog_ns + 2 * self._cycle_ns)
        drive.model.watchers.append(lambda state: self.trace.note(f"{axis.name}: drive in {state.value}"))
        return axis

    @property
    def bus(self) -> SimulatedCan:
        """The one bus."""
        return self.world.bus(_BUS)

    @property
    def gateway_port(self) -> Member:
        """The gateway's controller on it."""
        return self.world.gateway_port(_BUS)

    @property
    def starts(self) -> int:
        """How often a drive was started."""
        return sum(axis.starts for axis in self.axes)

    # -- playing ------------------------------------------------------------------------------------------------------

    def close(self) -> None:
        """The end of this world: what waits in it would keep it for ever."""
        self.loop.close()

    def play(self, until: int, progress: Callable[[int], None] = lambda now: None) -> None:
        """Up to a time of the day; ViolationError when something happened that must not."""
        with _told_to(self.trace):
            if self.loop.now() == self.begin:
                self.daemon.start()
                self.plc.start()
                self.loop.spawn(self._phases, "phases")
                self._check()
                for axis in self.axes:
                    self._talk(axis)
                self._trouble()
            while self.loop.now() < until:
                self.loop.run_until(min(until, self.loop.now() + SECOND))
                if self._violation is not None:
                    raise self._violation
                if self.loop.task_errors:
                    raise ViolationError("a task of the gateway ended with an error")
                if self.loop.waiting > _TIMERS_MAX:
                    raise ViolationError(f"{self.loop.waiting} timers wait: they only grow")
                progress(self.loop.now())

    def _phases(self) -> None:
        chance = self.world.chance("phases")
        try:
            while True:
                self._all_back()
                self.calm = False
                self.loop.sleep(int(chance.uniform(*_CHAOS_S) * SECOND))
                self.calm = True
                for name in list(self._active):
                    self._end(name)
        except ViolationError as violation:
            self._violation = violation

    def _all_back(self) -> None:
        """Without troubles, OFF, acknowledge and ON bring every axis into operation."""
        self.trace.note("calm: all axes have to operate")
        deadline = self.loop.now() + _BACK_NS
        for axis in self.axes:
            axis.drive.do(lambda node: node.model.clear())
        while not all(axis.drive.model.state is State.OPERATION_ENABLED for axis in self.axes):
            self._give(lambda axis: axis.words.off)
            while not all(self._ready(axis) for axis in self.axes):
                self._give(lambda axis: axis.words.off | ACKNOWLEDGE)
                self._give(lambda axis: axis.words.off)
                if self.loop.now() > deadline:
                    raise ViolationError(
                        f"not in operation {_BACK_NS // SECOND} s after the last trouble: {self._waiting()}"
                    )
            self._give(lambda axis: axis.words.off | 0x07)
            self._give(lambda axis: axis.words.on)

    def _give(self, word: Callable[[SoakAxis], int]) -> None:
        """Every axis a word, and time to obey."""
        for axis in self.axes:
            axis.words.set_word(word(axis))
        self.loop.sleep(_OBEY_NS)

    def _shown(self, axis: SoakAxis) -> int | None:
        """ZSW1 where the telegram has it."""
        return None if axis.words.telegram.number == TRANSPARENT else self.plc.value("ZSW1", axis.index)

    def _ready(self, axis: SoakAxis) -> bool:
        if axis.words.telegram.number == TRANSPARENT:
            return axis.drive.model.state is State.READY_TO_SWITCH_ON
        shown = self._shown(axis)
        return shown is not None and shown & _RUNNING_STATE == 1

    def _waiting(self) -> str:
        """Why axes do not operate."""
        return "; ".join(
            f"{axis.name}: drive in {axis.drive.model.state.value}, {item.reason.value if item.reason else 'no reason'}, "
            f"{item.client.status_text}"
            for axis, item in zip(self.axes, self.daemon.axes, strict=True)
            if axis.drive.model.state is not State.OPERATION_ENABLED
        )

    # -- the PLC ------------------------------------------------------------------------------------------------------

    def _talk(self, axis: SoakAxis) -> None:
        if not self.calm:
            before = axis.words.word
            axis.words.draw()
            if axis.words.word != before:
                self.trace.note(f"{axis.name}: PLC {axis.words.name} {axis.words.word:04X}h")
        self.loop.call_later(_exponential(axis.words.chance, _TALK_NS), lambda: self._talk(axis))

    def restart_plc(self) -> None:
        """Another relationship from another port."""
        self.plc.restart(self.world.network.open(PLC_HOST, 0, "PLC"))

    def _before_frame(self, now: int) -> None:
        if not self.plc.silent and self.plc.endpoint.run:
            # Frames that are all late alike are in order: the gateway cannot know, and need not.
            delay = self.world.network.conditions.delay_ns
            for axis in self.axes:
                axis.sent(now + delay)

    def _on_arrival(self, now: int, source: Address, target: Address, data: bytes) -> None:
        if target != self.daemon.address:
            return
        self._doubt_gap(now)
        self._arrived = now
        self._runs = bool(data[_STATUS_OFFSET] & STATUS_RUN)
        if not self._runs:
            for axis in self.axes:
                axis.doubt("provider STOP")

    def _doubt_gap(self, now: int) -> None:
        if now - self._arrived > self._watchdog_ns:
            for axis in self.axes:
                axis.doubt("PLC lost", self._arrived + self._watchdog_ns)

    # -- troubles -----------------------------------------------------------------------------------------------------

    def _trouble(self) -> None:
        chance = self._chance
        if not self.calm:
            (trouble,) = chance.choices(TROUBLES, [item.weight for item in TROUBLES])
            axis = chance.choice(self.axes)
            duration = int(math.exp(chance.uniform(math.log(_SHORTEST_NS), math.log(_LONGEST_NS))))
            if trouble.name not in self._active:
                self.trace.note(f"{axis.name}: {trouble.name} for {duration / MS:.0f} ms")
                self._active[trouble.name] = (trouble, axis, trouble.begin(self, axis, chance))
                self.loop.call_later(duration, lambda: self._end(trouble.name))
        self.loop.call_later(_exponential(chance, _PAUSE_NS), self._trouble)

    def _end(self, name: str) -> None:
        entry = self._active.pop(name, None)
        if entry is not None:
            self.trace.note(f"{entry[1].name}: {name} ends")
            entry[2]()
            self._touch(entry[0], entry[1])

    def _touch(self, trouble: Trouble, axis: SoakAxis) -> None:
        self._quiet_since = self.loop.now()
        if trouble.drive:
            axis.disturbed()

    # -- what is looked at --------------------------------------------------------------------------------------------

    def _check(self) -> None:
        now = self.loop.now()
        for trouble, axis, _ in self._active.values():
            self._touch(trouble, axis)
        self._doubt_gap(now)
        quiet = now - self._quiet_since > SETTLED_NS
        plc_there = self._runs and now - self._arrived <= self._watchdog_ns + self._cycle_ns
        port = self.gateway_port
        bus_there = port.connected and not port.bus_off and not self.bus.shorted
        for axis, item in zip(self.axes, self.daemon.axes, strict=True):
            online = item.client.status is NodeStatus.ONLINE
            if not online:
                axis.doubt("drive not online")
            reached = plc_there and bus_there and online and axis.member.connected
            axis.check(now, reached=reached, zsw1=self._shown(axis) if quiet and reached else None)
        self.loop.call_later(_CHECK_NS, self._check)

    def _on_offered(self, now: int, _: Member, can_id: int, data: bytes) -> None:
        node = can_id - _RPDO1
        if 0 < node <= len(self.axes) and data[0] & _ENABLE_MASK == _ENABLE:
            self.axes[node - 1].enabled(now)

    def _note_frame(self, _: int, sender: Member, can_id: int, data: bytes) -> None:
        self.trace.note(f"CAN {sender.name}: {can_id:03X}h {data.hex(' ')}")


def _configuration(numbers: Sequence[int]) -> GatewayConfig:
    axes = "".join(
        f"[[axis]]\ndo_id = {n}\nnode_id = {n}\ntelegram = {number}\nsimulate = true\n{_keys(number)}"
        for n, number in enumerate(numbers, 1)
    )
    return parse_config(
        f'[can]\ninterface = "virtual"\nchannel = "{_BUS}"\nbitrate = 1000000\n'
        f"[transport]\ncyclic_port = 0\nacyclic_port = 0\nstatus_port = 0\ncycle_time_ms = {CYCLE_MS}\n"
        f'listen = "{GATEWAY_HOST}"\npeer = "{PLC_HOST}"\n{axes}'
    )


def _keys(number: int) -> str:
    """What a telegram needs to be known beside."""
    if number in DSC_TELEGRAM_NUMBERS:
        return 'dsc = "speed"\nfollowing_window = 100000\n'
    return _POSITIONER if number in POSITIONER_TELEGRAM_NUMBERS else ""


def _exponential(chance: Random, mean: int) -> int:
    return int(chance.expovariate(1 / mean))


@contextmanager
def _told_to(trace: Trace) -> Iterator[None]:
    """The gateway's log goes into the trace alone."""
    loggers = [logging.getLogger(name) for name in ("gateway", "canopen")]
    before = [(logger.level, logger.propagate) for logger in loggers]
    loggers[0].addHandler(trace)
    loggers[0].setLevel(logging.INFO)
    loggers[1].setLevel(logging.CRITICAL)
    loggers[0].propagate = False
    try:
        yield
    finally:
        loggers[0].removeHandler(trace)
        for logger, (level, propagate) in zip(loggers, before, strict=True):
            logger.setLevel(level)
            logger.propagate = propagate
