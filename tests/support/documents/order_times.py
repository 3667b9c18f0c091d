"""What ends the motion of a drive that receives no RPDO any more, for each order of each telegram, in virtual time.

``measure`` runs a case from 100 % speed. ``make docs`` keeps the results of all cases in docs/measured/orders.txt, of which
docs/tables.md is made; a test compares a part of them.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final

from pdgw.base.durations import SECOND
from pdgw.gateway.axis.orders import ORDERS, Order
from pdgw.gateway.axis.settings import PlcLossReaction
from pdgw.gateway.axis.telegrams import (
    DRIVE_TELEGRAM_NUMBERS,
    DSC_TELEGRAM_NUMBERS,
    POSITIONER_TELEGRAM_NUMBERS,
    SPEED_TELEGRAM_NUMBERS,
)
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.configuration.defaults import SIMULATED_KEYS
from pdgw.gateway.configuration.file import parse_config
from pdgw.gateway.configuration.toml_file import toml_text
from pdgw.peers.drive import shape
from pdgw.peers.drive.model.ramps import INCREMENTS_PER_REVOLUTION
from pdgw.peers.world import Gateway
from pdgw.profidrive.datatypes import float_pattern
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import telegram
from tests.support.documents.parts import DOCS, numbers, table

PATH = DOCS / "measured" / "orders.txt"
Words = Mapping[str, int]
CYCLE_S = 0.02
_LIMIT_S: Final = 30
"""Longer than each order takes."""
_FULL: Final = 3000
"""100 % speed in rpm."""
_LENGTH: Final = 2_000_000_000
"""LU or more: the drive does not reach its target."""
N2, N4 = 0x4000, 0x4000_0000
_ON: Final = 0x047F
_POSITIONER: Final = SIMULATED_KEYS | {
    "jog_velocities": (30_000, -30_000),
    "homing_method": 17,
    "software_limits": (-_LENGTH, _LENGTH),
}
_BLOCKS: Final = (
    {"number": 1, "mode": "absolute", "position": _LENGTH, "velocity": 30_000},
    {"number": 2, "mode": "absolute", "position": _LENGTH, "velocity": 15_000},
    {"number": 3, "mode": "endless-positive", "velocity": 30_000},
)


def stw1(*zero: str, positioning: bool = False, one: tuple[str, ...] = ()) -> int:
    """STW1 of operation with these bits 0 and 1."""
    word = signal("STW1").word
    return _ON & ~word(*zero, positioning=positioning) | word(*one, positioning=positioning)


@dataclass(frozen=True)
class Motion:
    """How the axis comes to its speed: frames in their order. ``rpm``: that speed."""

    name: str
    frames: tuple[Words, ...]
    rpm: int = _FULL
    keys: str = ""


@dataclass(frozen=True)
class Case:
    """An order in a motion. ``names``: of the setpoint or bit; none for the gateway's own orders, which have no ``words``."""

    telegram: int
    motion: Motion
    text: str
    orders: tuple[Order, ...]
    names: tuple[str, ...] = ()
    frames: tuple[Words, ...] = ()
    on_plc_loss: PlcLossReaction | None = None

    @property
    def title(self) -> str:
        return f"{self.telegram}, {self.motion.name}: {self.text}"


@dataclass(frozen=True, order=True)
class Measured:
    """A line of the table. Times in seconds since the order."""

    motion: str
    text: str
    row: str
    rpm: int
    fault: int
    after_s: str
    rest_s: str
    turns: int
    telegram: int = field(default=0)

    def line(self) -> str:
        """As text."""
        return " | ".join(map(str, (self.telegram, *self.shown)))

    @property
    def shown(self) -> tuple[object, ...]:
        """What telegrams can have in common."""
        return (self.motion, self.text, self.row, self.rpm, self.fault, self.after_s, self.rest_s, self.turns)


# -- the cases ----------------------------------------------------------------------------------------------------------


def _power(number: int, motion: Motion, *, positioning: bool) -> Iterator[Case]:
    """Orders that all telegrams with STW1 have."""
    word = motion.frames[-1].get("STW1", _ON)
    for text, bit, order in (
        ("OFF1", "ON", Order.RAMP),
        ("OFF2", "NO_COAST_STOP", Order.OFF2),
        ("OFF3", "NO_QUICK_STOP", Order.STOP),
        ("STW1.3 = 0", "ENABLE_OPERATION", Order.DISABLE),
        ("STW1.10 = 0", "CONTROL_BY_PLC", Order.RAMP),
    ):
        words = {"STW1": word & ~signal("STW1").bit(bit, positioning=positioning).mask}
        yield Case(number, motion, text, (order,), (f"STW1.{bit}",), (words,))
    words = {"STW1": stw1("ENABLE_OPERATION")}
    switched_on = Motion("switched on", (words,), 0, motion.keys)
    yield Case(number, switched_on, "STW1.3 = 1", (Order.ENTER,), ("STW1.ENABLE_OPERATION",), ({"STW1": _ON},))


def _losses(number: int, motion: Motion) -> Iterator[Case]:
    """The gateway's own orders."""
    for reaction, order in (
        (PlcLossReaction.RAMP, Order.RAMP),
        (PlcLossReaction.QUICK_STOP, Order.STOP),
        (PlcLossReaction.COAST, Order.OFF2),
    ):
        yield Case(number, motion, f"loss of the PLC, {reaction.value}", (order,), on_plc_loss=reaction)


def _speed(number: int) -> Iterator[Case]:
    name, full = ("NSOLL_A", N2) if "NSOLL_A" in telegram(number).setpoints.names else ("NSOLL_B", N4)
    dsc = number in DSC_TELEGRAM_NUMBERS
    keys = 'dsc = "speed"\nfollowing_window = 1000000' if dsc else f"jog_speeds_rpm = [{_FULL}, {-_FULL}]"
    speed = Motion("speed", ({name: full},), keys=keys)
    yield from _power(number, speed, positioning=False)
    yield from _losses(number, speed)
    yield Case(number, speed, "setpoint 0", (Order.ZERO,), (name,), ({name: 0},))
    for text, value in (("half of the setpoint", full // 2), ("opposite setpoint", -full)):
        yield Case(number, speed, text, (Order.SETPOINT,), (name,), ({name: value},))
    if dsc:
        loop = Motion("position loop", ({name: full, "KPC": 1000},), keys=keys)
        yield Case(number, loop, "KPC and setpoint 0", (Order.ZERO,), ("KPC",), ({name: 0, "KPC": 0},))
        yield Case(number, loop, "setpoint 0", (Order.SETPOINT,), ("XERR",), ({name: 0},))
        return
    for text, bit in (("STW1.4 = 0", "ENABLE_RAMP_GENERATOR"), ("STW1.6 = 0", "ENABLE_SETPOINT")):
        yield Case(number, speed, text, (Order.ZERO,), (f"STW1.{bit}",), ({"STW1": stw1(bit)},))
    off = stw1("ENABLE_RAMP_GENERATOR", "UNFREEZE_RAMP_GENERATOR", "ENABLE_SETPOINT")
    jogs = ("JOG_1_ON", "JOG_2_ON")
    for number_of_jog, bit in enumerate(jogs, 1):
        rpm = _FULL if number_of_jog == 1 else -_FULL
        jog = Motion(f"jog {number_of_jog}", ({"STW1": off | signal("STW1").word(bit)},), rpm, keys)
        yield Case(number, jog, "end of the jog", (Order.ZERO,), (f"STW1.{bit}",), ({"STW1": off},))


def _edge(words: Words) -> tuple[Words, Words]:
    """A task with these words: STW1.6 is 0, then 1."""
    return {**words, "STW1": stw1("ACTIVATE_TASK", positioning=True)}, {"STW1": _ON}


def _stops(number: int, motion: Motion, order: Order) -> Iterator[Case]:
    """STW1.4 and .5 of a motion."""
    word = motion.frames[-1]["STW1"]
    for text, bit in (("STW1.4 = 0", "DO_NOT_REJECT"), ("STW1.5 = 0", "NO_INTERMEDIATE_STOP")):
        mask = signal("STW1").bit(bit, positioning=True).mask
        yield Case(number, motion, text, (order,), (f"STW1.{bit}",), ({"STW1": word & ~mask},))


def _homing(number: int, words: Words, rpm: int, keys: str) -> Iterator[Case]:
    off = stw1("ACTIVATE_TASK", positioning=True)
    on = {"STW1": off | signal("STW1").word("START_HOMING", positioning=True)}
    homing = Motion("homing", ({**words, "STW1": off}, on), -rpm, keys)
    yield Case(number, homing, "STW1.11 = 0", (Order.HALT,), ("STW1.START_HOMING",), ({"STW1": off},))


def _telegram_9(number: int) -> Iterator[Case]:
    words = {"SATZANW": 0x8000 | 17, "MDI_MOD": 1, "MDI_TARPOS": N4, "MDI_VELOCITY": N4, "MDI_ACC": N2, "MDI_DEC": N2}
    task = Motion("task", _edge(words))
    yield from _power(number, task, positioning=True)
    yield from _losses(number, task)
    yield from _stops(number, task, Order.HALT)
    yield Case(number, task, "SATZANW.15 = 0", (Order.HALT,), ("SATZANW.MDI",), ({"SATZANW": 17},))
    names = ("MDI_VELOCITY", "STW1.ACTIVATE_TASK")
    yield Case(number, task, "task with half of the speed", (Order.SETPOINT,), names, _edge({"MDI_VELOCITY": N4 // 2}))
    yield from _homing(number, {"SATZANW": 17, "MDI_VELOCITY": N4}, _FULL, "")


def _positioner(number: int) -> Iterator[Case]:
    names = telegram(number).setpoints.names
    keys = f"[axis.positioner]\n{toml_text(_POSITIONER)}"
    keys += "".join(f"[[axis.block]]\n{toml_text(block)}" for block in _BLOCKS)
    word = "POS_STW1" if "POS_STW1" in names else "SATZANW"
    full: Words = {"OVERRIDE": N2} if "OVERRIDE" in names else {}
    block = Motion("block", _edge({word: 1, **full}), keys=keys)
    endless = Motion("endless block", _edge({word: 3, **full}), keys=keys)
    yield from _power(number, block, positioning=True)
    yield from _losses(number, block)
    yield from _stops(number, block, Order.HALT)
    yield from _stops(number, endless, Order.ZERO)
    slower = (f"{word}.BLOCK", "STW1.ACTIVATE_TASK")
    yield Case(number, block, "block with half of the speed", (Order.SETPOINT,), slower, _edge({word: 2}))
    off = stw1("ACTIVATE_TASK", positioning=True)
    for number_of_jog, bit in enumerate(("JOG_1_ON", "JOG_2_ON"), 1):
        frames = ({**full, "STW1": off}, {"STW1": off | signal("STW1").word(bit)})
        rpm = _FULL if number_of_jog == 1 else -_FULL
        jog = Motion(f"jog {number_of_jog}", frames, rpm, keys)
        yield Case(number, jog, "end of the jog", (Order.ZERO,), (f"STW1.{bit}",), ({"STW1": off},))
        yield from _stops(number, jog, Order.ZERO) if number_of_jog == 1 else ()
    yield from _homing(number, full, 200, keys)
    if full:
        for motion, order in ((block, Order.HALT), (endless, Order.ZERO)):
            yield Case(number, motion, "OVERRIDE 0", (order,), ("OVERRIDE",), ({"OVERRIDE": 0},))
            half = ({"OVERRIDE": N2 // 2},)
            yield Case(number, motion, "OVERRIDE 50 %", (Order.SETPOINT,), ("OVERRIDE",), half)
        yield from _mdi(number, word, full, keys)


def _mdi(number: int, word: str, full: Words, keys: str) -> Iterator[Case]:
    """Tasks and setting up with the values of the frame."""
    floats = number == 112
    suffix = "_F" if floats else ""
    velocity = f"MDI_VELOCITY{suffix}"
    fast, slow = (float_pattern(30_000), float_pattern(15_000)) if floats else (30_000, 15_000)
    ramp = float_pattern(100.0) if floats else N2
    values = {f"MDI_TARPOS{suffix}": float_pattern(_LENGTH / 1000) if floats else _LENGTH, velocity: fast}
    values |= {f"MDI_ACC{suffix}": ramp, f"MDI_DEC{suffix}": ramp, **full}
    if word == "SATZANW":
        values["MDI_MOD"] = 1
        mdi, setting_up = 0x8000, 0
    else:
        bits = signal(word).word
        mdi, setting_up = bits("MDI", "ABSOLUTE"), bits("MDI", "SETTING_UP", "CONTINUOUS_UPDATE")
    task = Motion("task", _edge({word: mdi, **values}), keys=keys)
    yield from _stops(number, task, Order.HALT)
    half = _edge({velocity: slow})
    yield Case(number, task, "task with half of the speed", (Order.SETPOINT,), (velocity,), half)
    if not setting_up:
        return
    forward, backward = bits("POSITIVE_DIRECTION"), bits("NEGATIVE_DIRECTION")
    for sign, own, other, name in (
        (1, forward, backward, "NEGATIVE_DIRECTION"),
        (-1, backward, forward, "POSITIVE_DIRECTION"),
    ):
        motion = Motion(
            f"setting up{'' if sign > 0 else ', backward'}",
            _edge({word: setting_up | own, **values}),
            sign * _FULL,
            keys,
        )
        turned = ({word: setting_up | other},)
        yield Case(number, motion, "other direction", (Order.SETPOINT,), (f"{word}.{name}",), turned)
        if sign > 0:
            yield from _stops(number, motion, Order.ZERO)
            yield Case(number, motion, "OVERRIDE 0", (Order.ZERO,), ("OVERRIDE",), ({"OVERRIDE": 0},))
            update = (f"{word}.CONTINUOUS_UPDATE", velocity)
            yield Case(number, motion, "half of the speed", (Order.SETPOINT,), update, ({velocity: slow},))


def _raw(number: int) -> Iterator[Case]:
    ramps = {"Profile Velocity": 6000, "Profile Acceleration": 300, "Profile Deceleration": 300}
    limits = {"Dynamic Speed Limit": 6000, "Dynamic Torque Limit": 1000}
    words = {"Modes of Operation": 3, "Target Velocity": 6000, **ramps, **limits}
    yield from _losses(number, Motion("speed", (words,)))


def cases(number: int) -> Iterator[Case]:
    """The cases of a telegram."""
    if number in SPEED_TELEGRAM_NUMBERS or number in DSC_TELEGRAM_NUMBERS:
        yield from _speed(number)
    elif number in POSITIONER_TELEGRAM_NUMBERS:
        yield from _positioner(number)
    else:
        yield from (_telegram_9 if number == 9 else _raw)(number)


# -- one case -----------------------------------------------------------------------------------------------------------


def measure(case: Case) -> Measured:
    """Bring the axis to its speed, let the drive receive no more RPDO, and give the order."""
    motion = case.motion
    head = '[can]\ninterface = "virtual"\nchannel = "bus"\n[transport]\ncycle_time_ms = 20\nwatchdog_factor = 15\n'
    loss = f'on_plc_loss = "{case.on_plc_loss.value}"\n' if case.on_plc_loss else ""
    axis = f"[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = {case.telegram}\n{loss}{motion.keys}\n"
    gateway = Gateway(parse_config(f"{head}[trace]\nenabled = false\n{axis}"))
    drive = gateway.world.drive("bus", 1, shape=shape("endless"))
    with gateway:
        plc, model, loop, watched = gateway.plc, drive.model, gateway.world.loop, gateway.daemon.axes[0]
        raw, machine = case.telegram == 100, watched.machine
        for seconds, word in (
            (3, 0x06 if raw else 0x047E),
            (0.5, 0x07 if raw else 0x0477),
            (0.5, 0x0F if raw else _ON),
        ):
            plc.exchange(seconds, **{"Controlword" if raw else "STW1": word})
            if not motion.rpm and word == motion.frames[-1]["STW1"]:
                break
        for words in motion.frames if motion.rpm else ():
            plc.exchange(3, **words)
        speed = model.speed
        assert abs(speed - motion.rpm) <= abs(motion.rpm) / 10, f"{case.title}: {speed} rpm"
        drive.do(lambda node: node.start_fault("deaf"))
        began, place, row = loop.now(), model.machine_position, Order.NONE
        frames, found = list(case.frames), None
        while loop.now() - began < _LIMIT_S * SECOND:
            before = machine._stop.order  # what the fault is the end of
            _next_cycle(gateway, case, frames)
            found = next((item for item in watched.faults if item.time_ns > began and item.number in _ENDS), None)
            if found is not None:
                row = Order.SETPOINT if found.number == FaultNumber.VELOCITY else before
                break
        assert found is not None, f"{case.title}: nothing ends it"
        while abs(model.speed) > 1 and loop.now() - began < 2 * _LIMIT_S * SECOND:
            _next_cycle(gateway, case, frames)
        assert abs(model.speed) <= 1, f"{case.title}: it still turns"
        assert ORDERS[row].fault == found.number, f"{case.title}: {row.name}, fault {found.number}"
        turns = abs(model.machine_position - place) / INCREMENTS_PER_REVOLUTION
        after, rest = (found.time_ns - began) / SECOND, (loop.now() - began) / SECOND
    return Measured(
        motion.name,
        case.text,
        row.name.lower(),
        abs(round(speed)),
        int(found.number),
        f"{after:.1f}",
        f"{rest:.1f}" if motion.rpm else "0.0",
        round(turns),
        case.telegram,
    )


_ENDS: Final = {row.fault for row in ORDERS.values()}


def _next_cycle(gateway: Gateway, case: Case, frames: list[Words]) -> None:
    """One cycle of the PLC, which sends the frames of the order one after the other, or is silent."""
    if case.frames:
        gateway.plc.exchange(CYCLE_S, **(frames.pop(0) if frames else {}))
    else:
        gateway.world.loop.run_for(round(CYCLE_S * SECOND))


# -- the table ----------------------------------------------------------------------------------------------------------


def kept() -> list[Measured]:
    """The lines of docs/measured/orders.txt."""
    found = []
    for line in PATH.read_text(encoding="utf-8").splitlines():
        number, motion, text, row, rpm, fault, after, rest, turns = line.split(" | ")
        found.append(Measured(motion, text, row, int(rpm), int(fault), after, rest, int(turns), int(number)))
    return found


def order_table() -> str:
    """The table of docs/tables.md: telegrams with the same result are one line."""
    common: dict[tuple[object, ...], list[int]] = {}
    for item in kept():
        common.setdefault(item.shown, []).append(item.telegram)
    header = ("motion", "order", "row", "from rpm", "fault", "after s", "at rest after s", "revolutions", "telegrams")
    return table(header, ((*shown, numbers(sorted(found))) for shown, found in common.items()))


if __name__ == "__main__":
    logging.disable(logging.CRITICAL)
    lines = [measure(case).line() for number in DRIVE_TELEGRAM_NUMBERS for case in cases(number)]
    PATH.write_text("\n".join(lines) + "\n", encoding="utf-8")
