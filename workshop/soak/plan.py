"""The parts of a soaked day, and what each is made of: cycle time, drives, telegrams and settings, drawn by the seed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count
from random import Random
from typing import Final

from pdgw.durations import MS, SECOND
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

GATEWAY_HOST: Final = "192.168.0.5"
"""Beyond loopback, where the gateway expects frames that come late."""
CYCLES_MS: Final = range(1, 33)
PART_CYCLES: Final = 18_750
"""Every cycle time is drawn as often as the others, and gets as many cycles: a part of 32 ms lasts ten minutes."""
SHORTEST_PART_NS: Final = 60 * SECOND
"""Two calms with troubles between them."""
TRANSPARENT: Final = 100
_OF_THE_FAMILY: Final = ("engel", "synchronous")
_RPM: Final = (
    *("rpm", "counts", "si", "fixed-pdo", "no-event-timer", "node-guarding", "rpdo-timeout", "no-abort-option"),
    *("mode-late", "frozen", "two-edges", "stays-stopped", "four-pdo"),
)
_SPEED_ONLY: Final = ("vl", "csv", "no-range")
_POSITION_ONLY: Final = ("csp",)
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
"""The positioner of an axis on a shaft without an end."""
_TABLES: Final = f"""\
dsc = "speed"
following_window = 100000
jog_1_speed_rpm = -150
jog_2_speed_rpm = 150
{POSITIONER}[[axis.block]]
number = 1
position = 20000
velocity = 6000
[[axis.block]]
number = 2
position = -30000
velocity = 20000
"""
"""What the telegrams need; each axis has all of it, so that P922 can select each."""

_DRAWN = tuple(number for number in DRIVE_TELEGRAM_NUMBERS if number not in FLOAT_TELEGRAM_NUMBERS)
"""Telegrams a plan has by chance: random bits are no sensible floats."""


def shapes_of(number: int) -> tuple[str, ...]:
    """Shapes of drives that operate with a telegram; without those that need minutes to come online."""
    if number in DSC_TELEGRAM_NUMBERS:
        return ("synchronous",)
    if number == TRANSPARENT:
        return _OF_THE_FAMILY
    if number in POSITIONER_TELEGRAM_NUMBERS:
        return (*_OF_THE_FAMILY, *_POSITION_ONLY)
    if number in TASK_TELEGRAM_NUMBERS:
        return (*_OF_THE_FAMILY, *_POSITION_ONLY, *_RPM)
    return (*_OF_THE_FAMILY, *_RPM, *_SPEED_ONLY)


@dataclass(frozen=True, slots=True)
class AxisPlan:
    """One axis and its drive."""

    telegram: int
    shape: str
    latency: Latency
    on_plc_loss: PlcLossReaction
    control_lost: ControlLost

    def __str__(self) -> str:
        return (
            f"telegram {self.telegram}, drive {self.shape}, latency {self.latency.command_ms} and {self.latency.status_ms} ms, "
            f"on_plc_loss {self.on_plc_loss.value}, control_lost {self.control_lost.value}"
        )


@dataclass(frozen=True, slots=True)
class Plan:
    """One part: the same cycle for all axes."""

    cycle_ms: int
    axes: tuple[AxisPlan, ...]

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
        """What the gateway is started with; addresses of the PLC and of who else writes parameters."""
        axes = "".join(
            f"[[axis]]\ndo_id = {n}\nnode_id = {n}\ntelegram = {axis.telegram}\n"
            f'on_plc_loss = "{axis.on_plc_loss.value}"\ncontrol_lost = "{axis.control_lost.value}"\n{_TABLES}'
            for n, axis in enumerate(self.axes, 1)
        )
        return parse_config(
            f'[can]\ninterface = "virtual"\nchannel = "{channel}"\nbitrate = 1000000\n'
            f"[transport]\nstatus_port = 0\ncycle_time_ms = {self.cycle_ms}\n"
            f'listen = "{GATEWAY_HOST}"\npeer = "{plc}"\n[parameters]\nwrite_from = ["{plc}", "{engineer}"]\n{axes}'
        )


def draw_plan(chance: Random, axes: int, telegrams: Sequence[int] = ()) -> Plan:
    """Draw a part; ``telegrams``: those of the axes in turn, without any every axis draws its own."""
    numbers = [telegrams[n % len(telegrams)] if telegrams else chance.choice(_DRAWN) for n in range(axes)]
    return Plan(
        chance.choice(CYCLES_MS),
        tuple(
            AxisPlan(
                number,
                chance.choice(shapes_of(number)),
                Latency.draw(chance),
                chance.choice(list(PlcLossReaction)),
                chance.choice(list(ControlLost)),
            )
            for number in numbers
        ),
    )


@dataclass(frozen=True, slots=True)
class Part:
    """One part of the day of a seed; it begins with power-on, so that a moment of the day is reached again soon."""

    seed: int
    number: int
    begin: int
    """Time of the day (ns)."""
    plan: Plan

    @property
    def world_seed(self) -> str:
        """Decides everything that is left to chance in it."""
        return f"{self.seed} {self.number}"

    @property
    def end(self) -> int:
        """Time of the day (ns)."""
        return self.begin + self.plan.duration_ns


def parts(seed: int, axes: int = 2, telegrams: Sequence[int] = ()) -> Iterator[Part]:
    """The parts of a day, one after the other, without end; ``telegrams`` as for ``draw_plan``."""
    begin = 0
    for number in count():
        plan = draw_plan(Random(f"{seed} {number} plan"), axes, telegrams)
        part = Part(seed, number, begin, plan)
        yield part
        begin = part.end
