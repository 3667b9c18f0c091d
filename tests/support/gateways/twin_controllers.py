"""Two redundant controllers (system redundancy S2) with one gateway and one axis in virtual time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from pdgw.dsp402.states import State
from pdgw.durations import MS
from pdgw.gateway.reasons import FaultNumber
from pdgw.peers.controller.controller import IoController, Phase
from pdgw.peers.controller.project import Redundancy
from pdgw.peers.drive import SimulatedDrive
from pdgw.profidrive.telegrams import telegram
from pdgw.profinet.station import Identity, Station
from tests.support.gateways.daemon import axis, drive_of
from tests.support.gateways.profinet_daemon import OFF, ON, Plant, configuration, plant
from tests.support.wire.profinet import BACKUP_IP, BACKUP_MAC, DEVICE_IP

HOLD_MS = 200
CYCLE_NS = 4 * MS
BOUND_NS = 5 * CYCLE_NS
"""From what stops the axis to the command on CAN."""
SPEED, OTHER_SPEED = 0x1000, 0x0800


class Twins:
    """Two controllers of a plant with one turning axis: the first leads; both have the same setpoints."""

    def __init__(self, site: Plant, *, data_hold: int = 3) -> None:
        self.site = site
        self.one = site.plc
        of = replace(self.one.project, data_hold=data_hold)
        self.one.project = replace(of, redundancy=Redundancy(1, HOLD_MS))
        self.other = IoController(
            Station(Identity(BACKUP_MAC, 1, 1, "plc", "PLC"), "plc-2"),
            replace(of, redundancy=Redundancy(2, HOLD_MS)),
            DEVICE_IP,
            seed=2,
        )
        site.plcs[BACKUP_IP] = self.other
        self.half = telegram(1).setpoints
        self.connect(self.one)
        self.connect(self.other)
        self.one.lead(primary=True)

    @property
    def drive(self) -> SimulatedDrive:
        return drive_of(self.site.daemon)

    @property
    def turns(self) -> bool:
        model = self.drive.model
        return model.state is State.OPERATION_ENABLED and abs(model.velocity_actual) > 100

    def connect(self, plc: IoController) -> None:
        plc.start(self.site.loop.now())
        self.site.until(lambda: plc.phase is Phase.DATA, "connected")
        self.site.run(20 * MS)

    def set(self, plc: IoController, word: int, speed: int = 0) -> None:
        plc.set_output((1, 2), self.half.encode((word, speed)))

    def both(self, word: int, speed: int = 0) -> None:
        """As controllers with one program, both send the same."""
        for plc in (self.one, self.other):
            self.set(plc, word, speed)

    def enable(self) -> None:
        self.both(OFF, SPEED)
        self.site.until(lambda: self.site.word() & 0x4F == 0x01, "ready")
        self.both(ON, SPEED)
        self.site.until(lambda: self.site.word() & 0x4F == 0x07, "operation")
        self.site.run(300 * MS)
        assert self.turns

    def lost(self) -> bool:
        """The loss of the PLC is a fault of the axis."""
        return any(
            fault.number == FaultNumber.PLC_LOST for fault in self.site.daemon.axes[0].fault_log.unacknowledged()
        )


@contextmanager
def twins(tmp_path: Path, **settings: int) -> Iterator[Twins]:
    config = configuration(axis(1), tmp_path / "store.json", transport=f"switchover_ms = {HOLD_MS}")
    with plant(config) as site:
        made = Twins(site, **settings)
        made.enable()
        yield made


def hand_over(pair: Twins) -> None:
    pair.one.lead(primary=False)


def die(pair: Twins) -> None:
    pair.site.dead.add(pair.one)


def release(pair: Twins) -> None:
    pair.one.release(pair.site.loop.now())


WAYS = [hand_over, die, release]
