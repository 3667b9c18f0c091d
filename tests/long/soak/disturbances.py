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
    from tests.long.soak.soak_run import SoakRun
    from tests.long.soak.watch import SoakAxis

UNPLUGGED = "bus: interface unplugged"
"""While it is active, no gateway can start."""
PLC_HOST, SECOND_HOST = "192.168.0.10", "192.168.0.11"
Undo = Callable[[], None]


@dataclass(frozen=True, slots=True)
class Disturbance:
    """``begin`` starts the disturbance and returns the function that ends it. ``drive``: the drive itself is disturbed, not
    the path between it and the PLC.
    """

    name: str
    weight: int
    begin: Callable[[SoakRun, SoakAxis, Random], Undo]
    drive: bool = False


def _network(**chosen: Callable[[Random], float]) -> Callable[[SoakRun, SoakAxis, Random], Undo]:
    """Change the conditions of the network while it lasts."""

    def begin(soak_run: SoakRun, _: SoakAxis, chance: Random) -> Undo:
        network = soak_run.world.network
        network.conditions = replace(
            network.conditions,
            **{name: draw(chance) for name, draw in chosen.items()},  # type: ignore[arg-type]
        )
        plain = Conditions()

        def undo() -> None:
            network.conditions = replace(network.conditions, **{name: getattr(plain, name) for name in chosen})

        return undo

    return begin


def _cut_plc(soak_run: SoakRun, _: SoakAxis, __: Random) -> Undo:
    soak_run.world.network.cut(PLC_HOST)
    return lambda: soak_run.world.network.cut(PLC_HOST, False)


def _silent(soak_run: SoakRun, _: SoakAxis, __: Random) -> Undo:
    soak_run.plc.silent = True

    def undo() -> None:
        soak_run.plc.silent = False

    return undo


def _provider_stop(soak_run: SoakRun, _: SoakAxis, __: Random) -> Undo:
    soak_run.plc.endpoint.run = False

    def undo() -> None:
        soak_run.plc.endpoint.run = True

    return undo


def _iops_bad(soak_run: SoakRun, axis: SoakAxis, _: Random) -> Undo:
    soak_run.plc.endpoint.bad.add(axis.index)
    return lambda: soak_run.plc.endpoint.bad.discard(axis.index)


def _second_plc(soak_run: SoakRun, _: SoakAxis, __: Random) -> Undo:
    """Another PLC sends frames of the same layout with ON."""
    plc = CyclingPlc(
        soak_run.loop,
        soak_run.world.network.open(SECOND_HOST, 0, "second PLC"),
        soak_run.daemon.address,
        soak_run.plc.endpoint.telegrams,
        soak_run.daemon.cycle_ns,
    )
    for index, axis in enumerate(soak_run.axes):
        plc.endpoint.setpoints[index][axis.words.name] = axis.words.on
    plc.start()
    return plc.stop


def _other_master(soak_run: SoakRun, _: SoakAxis, __: Random) -> Undo:
    """A second gateway on the bus sends its heartbeat once."""
    member = soak_run.bus.join("other master")
    member.send(ERROR_CONTROL + GATEWAY_NODE_ID, bytes([NmtState.OPERATIONAL]))
    member.close()
    return lambda: None


def _foreign_nmt(soak_run: SoakRun, axis: SoakAxis, chance: Random) -> Undo:
    """A tool on the bus sends an NMT command to the node."""
    member = soak_run.bus.join("tool")
    member.send(NMT, bytes((chance.choice(list(NmtCommand)), axis.index + 1)))
    member.close()
    return lambda: None


def _plc_restarts(soak_run: SoakRun, _: SoakAxis, __: Random) -> Undo:
    soak_run.restart_plc()
    return lambda: None


def _bus_errors(soak_run: SoakRun, _: SoakAxis, chance: Random) -> Undo:
    soak_run.bus.error_rate = chance.uniform(0.02, 0.7)

    def undo() -> None:
        soak_run.bus.error_rate = 0.0

    return undo


def _cut_gateway(soak_run: SoakRun, _: SoakAxis, __: Random) -> Undo:
    port = soak_run.gateway_port
    port.connect(False)
    return lambda: port.connect(True)


def _cut_drive(_: SoakRun, axis: SoakAxis, __: Random) -> Undo:
    axis.member.connect(False)
    return lambda: axis.member.connect(True)


def _short(soak_run: SoakRun, _: SoakAxis, __: Random) -> Undo:
    soak_run.bus.short(True)
    return lambda: soak_run.bus.short(False)


def _unplug(soak_run: SoakRun, _: SoakAxis, __: Random) -> Undo:
    soak_run.world.unplug(soak_run.bus.name)
    return lambda: soak_run.world.unplug(soak_run.bus.name, False)


def _power_cycle(_: SoakRun, axis: SoakAxis, __: Random) -> Undo:
    axis.drive.do(lambda node: node.power_off())
    axis.require_new_off("power off")
    return lambda: axis.drive.do(lambda node: node.restart())


def _misbehaves(name: str) -> Disturbance:
    def begin(_: SoakRun, axis: SoakAxis, __: Random) -> Undo:
        axis.drive.do(lambda node: node.misbehave(name))
        return lambda: axis.drive.do(lambda node: node.behave(name))

    return Disturbance(f"drive: {name}", 1, begin, drive=True)


DISTURBANCES: tuple[Disturbance, ...] = (
    Disturbance("network: loss", 5, _network(loss=lambda chance: chance.uniform(0.05, 0.9))),
    Disturbance("network: duplicates", 3, _network(duplication=lambda chance: chance.uniform(0.05, 1.0))),
    Disturbance("network: overtaking", 5, _network(jitter_ns=lambda chance: chance.randrange(MS, 400 * MS))),
    Disturbance("network: delay", 3, _network(delay_ns=lambda chance: chance.randrange(MS, 300 * MS))),
    Disturbance("network: PLC cut off", 6, _cut_plc),
    Disturbance("PLC: silent", 5, _silent),
    Disturbance("PLC: provider STOP", 4, _provider_stop),
    Disturbance("PLC: restarts", 3, _plc_restarts),
    Disturbance("PLC: IOPS BAD", 4, _iops_bad),
    Disturbance("network: second PLC", 3, _second_plc),
    Disturbance("bus: other master", 1, _other_master),
    Disturbance("bus: foreign NMT command", 2, _foreign_nmt, drive=True),
    Disturbance("bus: errors", 5, _bus_errors),
    Disturbance("bus: gateway cut off", 8, _cut_gateway),
    Disturbance("bus: drive cut off", 5, _cut_drive),
    Disturbance("bus: short circuit", 3, _short),
    Disturbance(UNPLUGGED, 2, _unplug),
    Disturbance("drive: power cycle", 3, _power_cycle, drive=True),
    *(_misbehaves(name) for name in DRIVE_MISBEHAVIOURS),
)
"""Drawn by weight."""
