"""The parts of a soak day with cycle time, drives, telegrams and settings, drawn from the seed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from random import Random
from typing import Final

from pdgw.base.durations import MS, SECOND
from pdgw.gateway.axis.settings import ControlLost, PlcLossReaction
from pdgw.gateway.axis.telegrams import (
    DRIVE_TELEGRAM_NUMBERS,
    DSC_TELEGRAM_NUMBERS,
    FLOAT_TELEGRAM_NUMBERS,
    POSITIONER_TELEGRAM_NUMBERS,
    TASK_TELEGRAM_NUMBERS,
)
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.file import parse_config
from pdgw.peers.drive import Latency
from pdgw.peers.node.behaviour import HabitValues
from pdgw.profidrive.telegrams import Telegram, telegram
from tests.support.drives.latency import draw_latency

GATEWAY_HOST: Final = "192.168.0.5"
"""Not on loopback, so that the gateway expects late frames."""
CYCLES_MS: Final = range(1, 33)
_TWO_DSC_MS: Final = 2
"""Shortest cycle with more than one axis with DSC. The gateway refuses 1 ms, because their frames do not fit on 1 Mbit/s."""
PART_CYCLES: Final = 18_750
"""Cycles of a part. Each cycle time is equally likely; a part with 32 ms takes ten minutes."""
SHORTEST_PART_NS: Final = 60 * SECOND
"""Time for two calm periods with disturbances between them."""
TRANSPARENT: Final = 100
_OF_THE_FAMILY: Final = ("engel", "synchronous")
_RPM: Final = (
    *("rpm", "counts", "si", "fixed-pdo", "no-event-timer", "node-guarding", "rpdo-timeout", "no-abort-option"),
    *("mode-late", "frozen", "two-edges", "stays-stopped", "four-pdo", "speed-by-sdo"),
)
_SPEED_ONLY: Final = ("vl", "inverter", "csv", "no-range")
POSITIONER: Final = """\
[axis.positioner]
lu_per_revolution = 10000
lu_per_unit = 1000
velocity_per = "minute"
max_velocity = 30000
max_acceleration = 2000
max_deceleration = 2000
position_window = 20
"""
"""Positioner of an axis without end stops."""
_TABLES: Final = f"""\
dsc = "speed"
following_window = 100000
jog_speeds_rpm = [-150, 150]
{POSITIONER}"""
_BLOCKS: Final = """\
[[axis.block]]
number = 1
position = 20000
velocity = 6000
[[axis.block]]
number = 2
position = -30000
velocity = 20000
"""
"""Tables that telegrams need. Each axis has all of them, so that P922 can select each telegram."""

_DRAWN = tuple(number for number in DRIVE_TELEGRAM_NUMBERS if number not in FLOAT_TELEGRAM_NUMBERS)
"""Telegrams in random plans. Those with floats are left out: random bits are not useful floats."""


def shapes_of(number: int) -> tuple[str, ...]:
    """Drive variants that operate with a telegram, without those that take minutes to come online."""
    if number in DSC_TELEGRAM_NUMBERS:
        return ("synchronous",)
    if number == TRANSPARENT or number in POSITIONER_TELEGRAM_NUMBERS:
        return _OF_THE_FAMILY
    if number in TASK_TELEGRAM_NUMBERS:
        return (*_OF_THE_FAMILY, *_RPM)
    return (*_OF_THE_FAMILY, *_RPM, *_SPEED_ONLY)


def habits_text(habits: HabitValues) -> str:
    """Habits with their parameters, in the notation of the simulators' console; empty without any."""
    texts = (" ".join((name, *(f"{key}={value}" for key, value in values.items()))) for name, values in habits.items())
    return "".join(f", {text}" for text in texts)


def habits_ms(habits: HabitValues) -> int:
    """The times of habits, one after the other."""
    return sum(value for values in habits.values() for key, value in values.items() if key.endswith("_ms"))


@dataclass(frozen=True, slots=True)
class AxisPlan:
    """An axis and its drive."""

    telegram: int
    shape: str
    latency: Latency
    on_plc_loss: PlcLossReaction
    control_lost: ControlLost
    habits: HabitValues = field(default_factory=dict)
    """What the drive does besides."""
    keys: str = ""
    """Further keys of [[axis]]."""

    @property
    def late_ms(self) -> int:
        """Latency of the drive, with all times of its habits."""
        return self.latency.command_ms + self.latency.status_ms + habits_ms(self.habits)

    def __str__(self) -> str:
        return (
            f"telegram {self.telegram}, drive {self.shape}, latency {self.latency.command_ms} and {self.latency.status_ms} ms, "
            f"on_plc_loss {self.on_plc_loss.value}, control_lost {self.control_lost.value}{habits_text(self.habits)}"
        )


@dataclass(frozen=True, slots=True)
class Plan:
    """One part: a cycle time and its axes."""

    cycle_ms: int
    axes: tuple[AxisPlan, ...]
    encoder: int = 0
    """Telegram of the only encoder; 0 without one."""
    direct: bool = False
    """No frame of the PLC is late."""
    motion_keys: str = ""
    """Further keys of each positioner, then further blocks."""
    encoder_habits: HabitValues = field(default_factory=dict)
    """What the encoder does besides."""
    encoder_keys: str = ""
    """Further keys of [[encoder]]."""

    def __str__(self) -> str:
        encoder = [f"telegram {self.encoder}, encoder{habits_text(self.encoder_habits)}"] if self.encoder else []
        return "; ".join([f"cycle {self.cycle_ms} ms", *map(str, self.axes), *encoder])

    @property
    def telegrams(self) -> list[Telegram]:
        """Those of a frame, in the order of the drive objects."""
        return [telegram(number) for number in (*(axis.telegram for axis in self.axes), self.encoder) if number]

    @property
    def fits_bus(self) -> bool:
        """Whether the bus carries the frames of all axes in each cycle."""
        dsc = sum(axis.telegram in DSC_TELEGRAM_NUMBERS for axis in self.axes)
        return dsc < 2 or self.cycle_ms >= _TWO_DSC_MS

    @property
    def duration_ns(self) -> int:
        """Virtual time from power-on to the next part."""
        return max(SHORTEST_PART_NS, PART_CYCLES * self.cycle_ms * MS)

    def with_telegram(self, index: int, number: int) -> Plan:
        """The same part with another telegram of one axis."""
        axes = list(self.axes)
        axes[index] = replace(axes[index], telegram=number)
        return replace(self, axes=tuple(axes))

    def configuration(self, channel: str, plc: str, engineer: str) -> GatewayConfig:
        """Configuration of the gateway, with the addresses of the PLC and of the other parameter client."""
        axes = "".join(
            f"[[axis]]\ndo_id = {n}\nnode_id = {n}\ntelegram = {axis.telegram}\n"
            f'on_plc_loss = "{axis.on_plc_loss.value}"\ncontrol_lost = "{axis.control_lost.value}"\n'
            f"{axis.keys}{_TABLES}{self.motion_keys}{_BLOCKS}"
            for n, axis in enumerate(self.axes, 1)
        )
        if self.encoder:
            n = len(self.axes) + 1
            axes += f"[[encoder]]\ndo_id = {n}\nnode_id = {n}\ntelegram = {self.encoder}\n{self.encoder_keys}"
        return parse_config(
            f'[can]\ninterface = "virtual"\nchannel = "{channel}"\nbitrate = 1000000\n'
            f"[transport]\nstatus_port = 0\ncycle_time_ms = {self.cycle_ms}\ndirect = {str(self.direct).lower()}\n"
            f'listen = "{GATEWAY_HOST}"\npeer = "{plc}"\n[parameters]\nwrite_from = ["{plc}", "{engineer}"]\n{axes}'
        )


def draw_plan(chance: Random, axes: int, telegrams: Sequence[int] = ()) -> Plan:
    """Draw a part. ``telegrams``: those of the axes in turn; if empty, every axis draws its own."""
    numbers = [telegrams[n % len(telegrams)] if telegrams else chance.choice(_DRAWN) for n in range(axes)]
    plan = Plan(
        chance.choice(CYCLES_MS),
        tuple(
            AxisPlan(
                number,
                chance.choice(shapes_of(number)),
                draw_latency(chance),
                chance.choice(list(PlcLossReaction)),
                chance.choice(list(ControlLost)),
            )
            for number in numbers
        ),
    )
    return plan if plan.fits_bus else replace(plan, cycle_ms=_TWO_DSC_MS)


Draw = Callable[[Random, int, Sequence[int]], Plan]


@dataclass(frozen=True, slots=True)
class Part:
    """One part of the day of a seed. It starts with power-on, so that any time of the day can be repeated quickly."""

    seed: int
    number: int
    begin: int
    """Time of the day (ns)."""
    plan: Plan

    @property
    def world_seed(self) -> str:
        """Seed of all random choices in this part."""
        return f"{self.seed} {self.number}"

    @property
    def end(self) -> int:
        """Time of the day (ns)."""
        return self.begin + self.plan.duration_ns


def parts(seed: int, axes: int = 2, telegrams: Sequence[int] = (), draw: Draw = draw_plan) -> Iterator[Part]:
    """The parts of a day, in order and without end. ``axes``, ``telegrams``: as for ``draw``."""
    begin = 0
    for number in count():
        plan = draw(Random(f"{seed} {number} plan"), axes, telegrams)
        part = Part(seed, number, begin, plan)
        yield part
        begin = part.end
