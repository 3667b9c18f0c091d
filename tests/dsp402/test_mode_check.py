"""The mode display 6061h: what it must show when the mode is written, and in operation."""

from __future__ import annotations

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.dsp402.drive.client import DriveStatus
from pdgw.dsp402.drive_type import Dsp402Error
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import State
from pdgw.peers.drive import SimulatedDrive
from pdgw.peers.drive.model.model import DriveModel
from tests.support.drives.plant import Plant
from tests.support.gateways import site

NO_MODE = 0
AWAITS = "is checked again when the operation is enabled"
OFF, ON, STAY = [0x06], [0x06, 0x07, 0x0F], [0x0F]
SPEED = 1000


def _shows(drive: SimulatedDrive, mode: int, until_ns: int) -> None:
    """From now on 6061h is ``mode``, until this time."""

    def disguise(model: DriveModel, _now: int) -> None:
        if site.now() < until_ns:
            model.modes_of_operation_display = mode

    drive.do(lambda node: node.model.disguises.append(disguise))


@pytest.mark.parametrize(
    ("mode", "late", "shown", "for_ms", "outcome", "within_ms"),
    [
        (Mode.VELOCITY, False, NO_MODE, 500, "", (500, 520)),
        (Mode.VELOCITY, False, NO_MODE, 10_000, AWAITS, (1000, 1020)),
        (Mode.VELOCITY, False, Mode.POSITION, 10_000, "6061h: 1 is not allowed", (1000, 1020)),
        (Mode.VELOCITY, True, Mode.POSITION, 10_000, AWAITS, (0, 20)),
        (Mode.POSITION, False, NO_MODE, 10_000, "6061h: 0 is not allowed", (1000, 1020)),
        (Mode.POSITION, True, NO_MODE, 10_000, "6061h: 0 is not allowed", (1000, 1020)),
    ],
)
def test_only_a_speed_mode_that_is_not_shown_yet_may_wait_for_operation(
    plant: Plant, mode: Mode, late: bool, shown: int, for_ms: int, outcome: str, within_ms: tuple[int, int]
) -> None:
    drive = plant.power_on()
    client = plant.connected()
    begin = site.now()
    _shows(drive, shown, begin + for_ms * MS)
    job = client.submit(lambda client: client._mode.set(mode, late=late, only=False))
    site.wait_for(job.done, "an end")
    assert within_ms[0] * MS <= site.now() - begin <= within_ms[1] * MS
    error = job.exception(0)
    assert isinstance(error, Dsp402Error) is ("not allowed" in outcome)
    assert outcome in f"{error} {[event.text for event in plant.events]}"
    assert any(AWAITS in event.text for event in plant.events) is (outcome == AWAITS)


def _shown_after(drive: SimulatedDrive, delay: int) -> None:
    """6061h is 0 until the drive has been in operation for this time."""
    entered = [0]

    def disguise(model: DriveModel, _now: int) -> None:
        if model.state is not State.OPERATION_ENABLED:
            entered[0] = site.now()
        if site.now() - entered[0] < delay:
            model.modes_of_operation_display = NO_MODE

    drive.do(lambda node: node.model.disguises.append(disguise))


def test_mode_that_operation_shows_late_loses_no_start(plant: Plant) -> None:
    """Also after a first operation that was too short to show it. Until then the drive gets no speed."""
    drive = plant.power_on()
    _shown_after(drive, 900 * MS)
    client = plant.connected()
    for words, milliseconds, speed in ((OFF, 1500, 0), (ON, 500, 0), (OFF, 1500, 0), (ON, 850, 0), (STAY, 200, SPEED)):
        plant.run(words, milliseconds, target_velocity=SPEED)
        assert (client.status, client.generation) == (DriveStatus.ONLINE, 1), client.status_text
        assert drive.model.target_velocity == speed


def test_mode_that_operation_does_not_show_is_a_loss_after_a_second(plant: Plant) -> None:
    drive = plant.power_on()
    _shown_after(drive, 60 * SECOND)
    client = plant.connected()
    plant.run(ON, 950, target_velocity=SPEED)
    assert client.status is DriveStatus.ONLINE
    plant.run(STAY, 200, target_velocity=SPEED)
    assert "6061h shows 0 for 1 s in operation, not 3" in [event.text for event in plant.events]
    assert drive.model.target_velocity == 0
    drive.do(lambda node: node.model.disguises.clear())
    site.wait_for(lambda: client.refresh(site.now()) and client.generation == 2, "online again")
    plant.run(OFF, 200, target_velocity=SPEED)
    assert drive.model.target_velocity == SPEED, "the mode is shown: nothing is awaited"
    assert client.status is DriveStatus.ONLINE
