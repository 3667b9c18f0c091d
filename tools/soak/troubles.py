"""What goes wrong in a life: network, PLC, bus and drives; each begins, lasts and ends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from random import Random
from typing import TYPE_CHECKING

from pdgw.durations import MS
from pdgw.peers.drive.misbehaviour import DRIVE_MISBEHAVIOURS
from pdgw.peers.world import Conditions

if TYPE_CHECKING:
    from pdgw.tools.soak.life import Life
    from pdgw.tools.soak.watch import SoakAxis

GATEWAY_HOST = "192.168.0.5"
"""Beyond loopback, where the gateway expects frames that come late."""
PLC_HOST = "192.168.0.10"
Undo = Callable[[], None]


@dataclass(frozen=True, slots=True)
class Trouble:
    """``begin`` returns what ends it. ``drive``: the drive of an axis is disturbed itself, not what is between it and the PLC."""

    name: str
    weight: int
    begin: Callable[[Life, SoakAxis, Random], Undo]
    drive: bool = False


def _network(**chosen: Callable[[Random], float]) -> Callable[[Life, SoakAxis, Random], Undo]:
    """Other conditions on the network while it lasts."""

    def begin(life: Life, _: SoakAxis, chance: Random) -> Undo:
        network = life.world.network
        network.conditions = replace(
            network.conditions,
            **{name: draw(chance) for name, draw in chosen.items()},  # type: ignore[arg-type]
        )
        plain = Conditions()

        def undo() -> None:
            network.conditions = replace(network.conditions, **{name: getattr(plain, name) for name in chosen})

        return undo

    return begin


def _cut_plc(life: Life, _: SoakAxis, __: Random) -> Undo:
    life.world.network.cut(PLC_HOST)
    return lambda: life.world.network.cut(PLC_HOST, False)


def _silent(life: Life, _: SoakAxis, __: Random) -> Undo:
    life.plc.silent = True

    def undo() -> None:
        life.plc.silent = False

    return undo


def _provider_stop(life: Life, _: SoakAxis, __: Random) -> Undo:
    life.plc.endpoint.run = False

    def undo() -> None:
        life.plc.endpoint.run = True

    return undo


def _plc_restarts(life: Life, _: SoakAxis, __: Random) -> Undo:
    life.restart_plc()
    return lambda: None


def _bus_errors(life: Life, _: SoakAxis, chance: Random) -> Undo:
    life.bus.error_rate = chance.uniform(0.02, 0.7)

    def undo() -> None:
        life.bus.error_rate = 0.0

    return undo


def _cut_gateway(life: Life, _: SoakAxis, __: Random) -> Undo:
    port = life.gateway_port
    port.connect(False)
    return lambda: port.connect(True)


def _cut_drive(_: Life, axis: SoakAxis, __: Random) -> Undo:
    axis.member.connect(False)
    return lambda: axis.member.connect(True)


def _short(life: Life, _: SoakAxis, __: Random) -> Undo:
    life.bus.short(True)
    return lambda: life.bus.short(False)


def _unplug(life: Life, _: SoakAxis, __: Random) -> Undo:
    life.world.unplug(life.bus.name)
    return lambda: life.world.unplug(life.bus.name, False)


def _power_cycle(_: Life, axis: SoakAxis, __: Random) -> Undo:
    axis.drive.do(lambda node: node.power_off())
    axis.doubt("power off")
    return lambda: axis.drive.do(lambda node: node.restart())


def _misbehaves(name: str) -> Trouble:
    def begin(_: Life, axis: SoakAxis, __: Random) -> Undo:
        axis.drive.do(lambda node: node.misbehave(name))
        return lambda: axis.drive.do(lambda node: node.behave(name))

    return Trouble(f"drive: {name}", 1, begin, drive=True)


TROUBLES: tuple[Trouble, ...] = (
    Trouble("network: loss", 5, _network(loss=lambda chance: chance.uniform(0.05, 0.9))),
    Trouble("network: duplicates", 3, _network(duplication=lambda chance: chance.uniform(0.05, 1.0))),
    Trouble("network: overtaking", 5, _network(jitter_ns=lambda chance: chance.randrange(MS, 400 * MS))),
    Trouble("network: delay", 3, _network(delay_ns=lambda chance: chance.randrange(MS, 300 * MS))),
    Trouble("network: PLC cut off", 6, _cut_plc),
    Trouble("PLC: silent", 5, _silent),
    Trouble("PLC: provider STOP", 4, _provider_stop),
    Trouble("PLC: restarts", 3, _plc_restarts),
    Trouble("bus: errors", 5, _bus_errors),
    Trouble("bus: gateway cut off", 8, _cut_gateway),
    Trouble("bus: drive cut off", 5, _cut_drive),
    Trouble("bus: short circuit", 3, _short),
    Trouble("bus: interface unplugged", 2, _unplug),
    Trouble("drive: power cycle", 3, _power_cycle, drive=True),
    *(_misbehaves(name) for name in DRIVE_MISBEHAVIOURS),
)
"""Drawn by weight."""
