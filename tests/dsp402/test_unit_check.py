"""What the drive client asks by SDO in operation: the objects of the units, and a position that no TPDO contains."""

from __future__ import annotations

from itertools import pairwise

import can
import pytest

from pdgw.base.durations import MS
from pdgw.ds301.communication import NMT, SDO_REQUEST, NmtCommand
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.pdo.layouts import Operation
from tests.support.drives.plant import NODE, Plant
from tests.support.gateways import site

ON, STAY = [0x06, 0x07, 0x0F], [0x0F]
POSITION = 0x6064
READ = 0x40


def _turning(plant: Plant, operation: Operation = Operation.VELOCITY, **settings: int) -> list[tuple[int, int]]:
    """Time and index of what is read by SDO of a drive that turns from now on."""
    plant.connected(operation, **settings)
    plant.run(ON, 200, target_velocity=1000, modes_of_operation=Mode.VELOCITY)
    asked: list[tuple[int, int]] = []

    def observe(message: can.Message) -> None:
        if message.arbitration_id == SDO_REQUEST + NODE and message.data[0] == READ:
            asked.append((site.now(), int.from_bytes(message.data[1:3], "little")))

    plant.network.listeners.append(observe)
    return asked


def _positions(plant: Plant, milliseconds: int) -> list[int]:
    """The times of the positions that are used."""
    client, found = plant.client, list[int]()
    assert client is not None
    for _ in range(milliseconds // 4):
        plant.run(STAY, 4, target_velocity=1000)
        if client.units.position_ns not in found:
            found.append(client.units.position_ns)
    return found


@pytest.mark.parametrize(("operation", "by_sdo"), [(Operation.VELOCITY, True), (Operation.POSITIONER, False)])
def test_position_is_asked_by_sdo_only_without_a_tpdo(plant: Plant, operation: Operation, by_sdo: bool) -> None:
    asked = _turning(plant, operation)
    plant.run(STAY, 2000, target_velocity=1000)
    indices = {index for _, index in asked}
    assert 0x6094 in indices, "the units are"
    assert (POSITION in indices) is by_sdo


@pytest.mark.parametrize(("delay_ms", "gap_ms"), [(1, (40, 220)), (30, (150, 350)), (60, (300, 700))])
def test_position_by_sdo_is_as_old_as_its_request_and_far_from_the_last_one(
    plant: Plant, delay_ms: int, gap_ms: tuple[int, int]
) -> None:
    """The drive may read it at any time between request and answer: the longer that is, the longer the way must be."""
    drive = plant.power_on()
    asked = _turning(plant)
    drive.do(lambda node: node.start_fault("slow-sdo", delay_ms=delay_ms))
    _positions(plant, 200)
    times = _positions(plant, 4000)[1:]
    assert set(times) <= {time for time, index in asked if index == POSITION}
    gaps = [(later - earlier) // MS for earlier, later in pairwise(times)]
    assert gap_ms[0] <= min(gaps)
    assert max(gaps) <= gap_ms[1]


def test_position_by_sdo_does_not_count_beside_an_old_velocity(plant: Plant) -> None:
    """A drive that has left Operational still answers SDOs."""
    drive = plant.power_on()
    asked = _turning(plant, heartbeat_ms=5000, tpdo_timeout_factor=100)  # it is not lost at once
    assert len(_positions(plant, 2000)) > 10
    drive.do(lambda node: node.receive(NMT, bytes((NmtCommand.ENTER_PRE_OPERATIONAL, NODE)), node.now))
    _positions(plant, 200)
    before = len(asked)
    assert len(_positions(plant, 2000)) == 1
    assert POSITION in [index for _, index in asked[before:]]


def test_position_by_sdo_counts_beside_a_velocity_by_sdo(plant: Plant) -> None:
    """The drive is mapped again when it is found that no TPDO shows its velocity."""
    plant.power_on(misbehaves="frozen-velocity")
    _turning(plant)
    plant.online(2)
    plant.run(ON, 200, target_velocity=1000)
    assert len(_positions(plant, 2000)) > 10
