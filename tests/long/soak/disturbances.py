"""Disturbances of the soak in network, PLC, bus and drives, with start, duration and end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from random import Random
from typing import TYPE_CHECKING

from pdgw.base.durations import MS
from pdgw.ds301.communication import DEFAULT_GATEWAY_NODE_ID, ERROR_CONTROL, NMT, NmtCommand, NmtState
from pdgw.peers.plc.exchange.plc import Plc
from pdgw.peers.world import Conditions
from tests.conformance.fault_cases import DRIVE_CASES

if TYPE_CHECKING:
    from tests.long.soak.soak_run import SoakRun
    from tests.long.soak.watch import SoakAxis

UNPLUGGED = "bus: interface unplugged"
"""While it is active, no gateway can start."""
PLC_HOST, SECOND_HOST = "192.168.0.10", "192.168.0.11"
Undo = Callable[[], object]


Begin = Callable[["SoakRun", "SoakAxis", Random], Undo]


@dataclass(frozen=True, slots=True)
class Disturbance:
    """``begin`` starts the disturbance and returns the function that ends it. ``drive``: the drive itself is disturbed, not
    the path between it and the PLC.
    """

    name: str
    weight: int
    begin: Begin
    drive: bool = False


def _network(name: str, draw: Callable[[Random], float]) -> Begin:
    """Change a condition of the network while it lasts."""

    def begin(soak_run: SoakRun, _: SoakAxis, chance: Random) -> Undo:
        network = soak_run.world.network

        def change(value: float) -> None:
            network.conditions = replace(network.conditions, **{name: value})  # type: ignore[arg-type]

        change(draw(chance))
        return partial(change, getattr(Conditions(), name))

    return begin


def _switch(find: Callable[[SoakRun, SoakAxis], Callable[[bool], object]], on: bool = True) -> Begin:
    """Call a function with ``on``, and in the end with its contrary."""

    def begin(soak_run: SoakRun, axis: SoakAxis, _: Random) -> Undo:
        switch = find(soak_run, axis)
        switch(on)
        return partial(switch, not on)

    return begin


def _once(act: Callable[[SoakRun, SoakAxis, Random], None]) -> Begin:
    """An event without an end."""

    def begin(soak_run: SoakRun, axis: SoakAxis, chance: Random) -> Undo:
        act(soak_run, axis, chance)
        return lambda: None

    return begin


def _send(soak_run: SoakRun, can_id: int, data: bytes) -> None:
    """Another device on the bus sends a frame."""
    member = soak_run.bus.join("other")
    member.send(can_id, data)
    member.close()


def _iops_bad(soak_run: SoakRun, axis: SoakAxis, _: Random) -> Undo:
    soak_run.plc.endpoint.bad.add(axis.index)
    return lambda: soak_run.plc.endpoint.bad.discard(axis.index)


def _second_plc(soak_run: SoakRun, _: SoakAxis, __: Random) -> Undo:
    """Another PLC sends frames of the same layout with ON."""
    plc = Plc(
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


def _other_master(soak_run: SoakRun, _: SoakAxis, __: Random) -> None:
    """A second gateway sends its heartbeat once."""
    _send(soak_run, ERROR_CONTROL + DEFAULT_GATEWAY_NODE_ID, bytes([NmtState.OPERATIONAL]))


def _foreign_nmt(soak_run: SoakRun, axis: SoakAxis, chance: Random) -> None:
    """A tool sends an NMT command to the node."""
    _send(soak_run, NMT, bytes((chance.choice(list(NmtCommand)), axis.index + 1)))


def _bus_errors(soak_run: SoakRun, _: SoakAxis, chance: Random) -> Undo:
    soak_run.bus.error_rate = chance.uniform(0.02, 0.7)
    return partial(setattr, soak_run.bus, "error_rate", 0.0)


def _power_cycle(_: SoakRun, axis: SoakAxis, __: Random) -> Undo:
    axis.drive.do(lambda node: node.power_off())
    axis.require_new_off("power off")
    return lambda: axis.drive.do(lambda node: node.restart())


_NOT_DRAWN = {"heartbeat-period", "brake-closes", "pre-operational-at-emcy", "enables-itself"}
"""Habits of a whole life, and one that breaks the rules of a start itself."""


def _misbehaves(name: str) -> Disturbance:
    def begin(_: SoakRun, axis: SoakAxis, __: Random) -> Undo:
        axis.drive.do(lambda node: node.start_fault(name))
        return lambda: axis.drive.do(lambda node: node.end_fault(name))

    return Disturbance(f"drive: {name}", 1, begin, drive=True)


DISTURBANCES: tuple[Disturbance, ...] = (
    Disturbance("network: loss", 5, _network("loss", lambda chance: chance.uniform(0.05, 0.9))),
    Disturbance("network: duplicates", 3, _network("duplication", lambda chance: chance.uniform(0.05, 1.0))),
    Disturbance("network: overtaking", 5, _network("jitter_ns", lambda chance: chance.randrange(MS, 400 * MS))),
    Disturbance("network: delay", 3, _network("delay_ns", lambda chance: chance.randrange(MS, 300 * MS))),
    Disturbance("network: PLC cut off", 6, _switch(lambda run, _: partial(run.world.network.cut, PLC_HOST))),
    Disturbance("PLC: silent", 5, _switch(lambda run, _: partial(setattr, run.plc, "silent"))),
    Disturbance("PLC: provider STOP", 4, _switch(lambda run, _: partial(setattr, run.plc.endpoint, "run"), on=False)),
    Disturbance("PLC: restarts", 3, _once(lambda run, _, __: run.restart_plc())),
    Disturbance("PLC: IOPS BAD", 4, _iops_bad),
    Disturbance("network: second PLC", 3, _second_plc),
    Disturbance("bus: other master", 1, _once(_other_master)),
    Disturbance("bus: foreign NMT command", 2, _once(_foreign_nmt), drive=True),
    Disturbance("bus: errors", 5, _bus_errors),
    Disturbance("bus: gateway cut off", 8, _switch(lambda run, _: run.gateway_port.connect, on=False)),
    Disturbance("bus: drive cut off", 5, _switch(lambda _, axis: axis.member.connect, on=False)),
    Disturbance("bus: short circuit", 3, _switch(lambda run, _: run.bus.short)),
    Disturbance(UNPLUGGED, 2, _switch(lambda run, _: partial(run.world.unplug, run.bus.name))),
    Disturbance("drive: power cycle", 3, _power_cycle, drive=True),
    *(_misbehaves(name) for name in dict.fromkeys(case.fault for case in DRIVE_CASES) if name not in _NOT_DRAWN),
)
"""Drawn by weight."""
