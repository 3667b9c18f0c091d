"""Disturbances of the soak in network, PLC, bus and drives, with start, duration and end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from random import Random
from typing import TYPE_CHECKING

from pdgw.ds301.connection_set import ERROR_CONTROL, NMT
from pdgw.ds301.nmt import NmtCommand, NmtState
from pdgw.ds301.node.node import GATEWAY_NODE_ID
from pdgw.durations import MS
from pdgw.peers.drive.misbehaviour import DRIVE_MISBEHAVIOURS
from pdgw.peers.plc.exchange.cycling import CyclingPlc
from pdgw.peers.world import Conditions

if TYPE_CHECKING:
    from pdgw.workshop.soak.life import Life
    from pdgw.workshop.soak.watch import SoakAxis

UNPLUGGED = "bus: interface unplugged"
"""While it is active, no gateway can start."""
PLC_HOST, SECOND_HOST = "192.168.0.10", "192.168.0.11"
Undo = Callable[[], None]


@dataclass(frozen=True, slots=True)
class Trouble:
    """``begin`` starts the disturbance and returns the function that ends it. ``drive``: the drive itself is disturbed, not
    the path between it and the PLC.
    """

    name: str
    weight: int
    begin: Callable[[Life, SoakAxis, Random], Undo]
    drive: bool = False


def _network(**chosen: Callable[[Random], float]) -> Callable[[Life, SoakAxis, Random], Undo]:
    """Change the conditions of the network while it lasts."""

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


def _iops_bad(life: Life, axis: SoakAxis, _: Random) -> Undo:
    life.plc.endpoint.bad.add(axis.index)
    return lambda: life.plc.endpoint.bad.discard(axis.index)


def _second_plc(life: Life, _: SoakAxis, __: Random) -> Undo:
    """Another PLC sends frames of the same layout with ON."""
    plc = CyclingPlc(
        life.loop,
        life.world.network.open(SECOND_HOST, 0, "second PLC"),
        life.daemon.address,
        life.plc.endpoint.telegrams,
        life.daemon.cycle_ns,
    )
    for index, axis in enumerate(life.axes):
        plc.endpoint.setpoints[index][axis.words.name] = axis.words.on
    plc.start()
    return plc.stop


def _other_master(life: Life, _: SoakAxis, __: Random) -> Undo:
    """A second gateway on the bus sends its heartbeat once."""
    member = life.bus.join("other master")
    member.send(ERROR_CONTROL + GATEWAY_NODE_ID, bytes([NmtState.OPERATIONAL]))
    member.close()
    return lambda: None


def _foreign_nmt(life: Life, axis: SoakAxis, chance: Random) -> Undo:
    """A tool on the bus sends an NMT command to the node."""
    member = life.bus.join("tool")
    member.send(NMT, bytes((chance.choice(list(NmtCommand)), axis.index + 1)))
    member.close()
    return lambda: None


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
    Trouble("PLC: IOPS BAD", 4, _iops_bad),
    Trouble("network: second PLC", 3, _second_plc),
    Trouble("bus: other master", 1, _other_master),
    Trouble("bus: foreign NMT command", 2, _foreign_nmt, drive=True),
    Trouble("bus: errors", 5, _bus_errors),
    Trouble("bus: gateway cut off", 8, _cut_gateway),
    Trouble("bus: drive cut off", 5, _cut_drive),
    Trouble("bus: short circuit", 3, _short),
    Trouble(UNPLUGGED, 2, _unplug),
    Trouble("drive: power cycle", 3, _power_cycle, drive=True),
    *(_misbehaves(name) for name in DRIVE_MISBEHAVIOURS),
)
"""Drawn by weight."""
