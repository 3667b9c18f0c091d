"""Traversing tasks of a drive without 6081h: its own velocity, 100 %, is the only one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import pytest

from pdgw.dsp402.drive_type import DriveType, Quantity
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.motion.blocks import Block, BlockMode, BlockNext
from pdgw.gateway.motion.requests import FULL
from pdgw.gateway.motion.states import State
from pdgw.peers.drive import SimulatedDrive, shape
from pdgw.profidrive.signals import signal
from tests.support.axis.positioner import ABSOLUTE, PositionerRig, move
from tests.support.gateways.daemon import POSITIONER, Plc, axis, configuration, running, until, world_of

RPM = shape("rpm")
SHAPE = replace(
    RPM,
    name="own velocity",
    lacks=RPM.lacks | {0x6081},
    has=tuple(spec for spec in RPM.has if spec.index != 0x6081),
)
OWN_RPM = 2000
KEYS = 'counts_per_revolution = 4096\nacceleration_unit = "rpm/s"\n'
ONLY = 30_000
"""100 %, in 1000 LU/min."""
FULL_SPEED = {**ABSOLUTE, "velocity": ONLY}


def positioner(*blocks: Block) -> PositionerRig:
    rig = PositionerRig(blocks=blocks)
    rig.positioner.course.only_velocity = ONLY
    return rig


def test_task_at_100_percent_runs() -> None:
    rig = positioner()
    move(rig, target=5000, **FULL_SPEED)
    rig.run_out()
    assert (rig.position, rig.result.reason) == (5000, None)


@pytest.mark.parametrize("values", [{"velocity": ONLY - 1}, {"override": FULL - 1}, {"override": 0}])
@pytest.mark.parametrize("moving", [False, True])
def test_task_below_100_percent_is_refused(values: dict[str, int], moving: bool) -> None:
    rig = positioner()
    if moving:
        move(rig, target=90_000, **FULL_SPEED)
        rig.step(20)
    before = len(rig.starts)
    move(rig, **{"target": 5000, **FULL_SPEED, **values})
    rig.run_out()
    assert len(rig.starts) == before
    assert (rig.result.state, rig.result.reason) == (State.IDLE, Reason.TASK_VELOCITY)
    assert not rig.result.acknowledged
    rig.step(override=FULL)
    rig.run_out()
    assert len(rig.starts) == before, "an override starts nothing"


def test_velocity_and_override_count_as_their_product() -> None:
    rig = positioner()
    move(rig, target=5000, **{**FULL_SPEED, "velocity": ONLY // 2, "override": 2 * FULL - 2})
    rig.run_out()
    assert rig.result.reason is Reason.TASK_VELOCITY
    move(rig, velocity=2 * ONLY)
    rig.run_out()
    assert (rig.position, rig.result.reason) == (5000, None)


@pytest.mark.parametrize("override", [FULL // 2, 0])
def test_changed_override_ends_a_task_and_never_resumes_it(override: int) -> None:
    rig = positioner()
    move(rig, target=90_000, **FULL_SPEED)
    rig.step(20)
    assert rig.speed
    rig.step(override=override)
    rig.run_out()
    assert rig.result.reason is Reason.TASK_VELOCITY
    rig.step(override=FULL)
    rig.run_out()
    assert len(rig.starts) == 1
    move(rig, target=90_000)
    rig.run_out()
    assert (rig.position, rig.result.reason) == (90_000, None)


def test_override_above_100_percent_keeps_the_task() -> None:
    rig = positioner()
    move(rig, target=90_000, **FULL_SPEED)
    rig.step(20, override=FULL + 1)
    rig.run_out()
    assert (rig.position, rig.result.reason) == (90_000, None)


@pytest.mark.parametrize("velocity", [3000, ONLY])
def test_block_moves_at_100_percent_only(velocity: int) -> None:
    first = Block(1, 4000, ONLY, next=BlockNext.FLYING)
    rig = positioner(first, Block(2, 8000, velocity), Block(3, mode=BlockMode.ENDLESS_POSITIVE, velocity=300))
    move(rig, mdi=False, number=1)
    rig.run_out()
    reached = velocity == ONLY
    assert (rig.position, rig.result.reason) == ((8000, None) if reached else (4000, Reason.TASK_VELOCITY))
    move(rig, number=3)
    rig.step(20)
    assert rig.speed, "an endless block is no task to a position"


def test_jog_to_a_software_limit_is_a_task_at_100_percent() -> None:
    rig = positioner()
    rig.step(20, jog_2=True)
    assert rig.speed, "profile velocity mode"
    rig.step(jog_2=False)
    rig.run_out()
    rig.home()
    for values in ({"jog_incremental": False}, {"jog_incremental": True}):
        before = rig.position
        rig.step(20, jog_2=True, **values)
        assert (rig.position, rig.result.reason) == (before, Reason.TASK_VELOCITY)
        rig.step(jog_2=False)
        rig.run_out()


def test_a_usual_drive_runs_slow_tasks() -> None:
    rig = PositionerRig()
    move(rig, target=5000, **{**ABSOLUTE, "override": FULL // 2})
    rig.run_out()
    assert (rig.position, rig.result.reason) == (5000, None)


@contextmanager
def gateway(number: int, more: str = "") -> Iterator[tuple[Plc, SimulatedDrive]]:
    """A running gateway with the drive in operation."""
    with running(configuration(axis(1, telegram_number=number, more=KEYS + more))) as daemon:
        drive = world_of(daemon).drive("world", 1, shape=SHAPE)
        client = daemon.axes[0].drive
        until(daemon, lambda: client.generation or client.status.value == "refused", "online")
        assert client.generation, client.status_text
        assert client.plan is not None
        assert [line for line in client.plan.lines if "6081h" in line] == [
            "Profile Velocity 6081h not available: traversing tasks run at the drive's own velocity: only tasks with 100 % "
            "are possible"
        ]
        plc = Plc(daemon, [number])
        plc.enable()
        yield plc, drive


def reached(plc: Plc) -> bool:
    return bool(signal("ZSW1").bit("TARGET_REACHED").of(plc.value("ZSW1")))


def test_telegram_9_positions_at_the_velocity_of_the_drive() -> None:
    with gateway(9) as (plc, drive):
        kind = plc.daemon.axes[0].drive.drive_type
        assert isinstance(kind, DriveType)
        target = int((163_840 << 30) / kind.scaling.reference(Quantity.POSITION))
        task = {"SATZANW": 0x8000, "MDI_TARPOS": target, "MDI_MOD": 1, "MDI_ACC": 0x4000, "MDI_DEC": 0x4000}
        for velocity in (0x2000_0000, 0x3FF0_0000, 0x4000_0000):
            plc.endpoint.set(0, {**task, "STW1": 0x043F, "MDI_VELOCITY": velocity})
            plc.exchange()
            plc.exchange()
            plc.endpoint.set(0, {"STW1": 0x047F})
            for _ in range(20):
                plc.exchange()
            refused = velocity < 0x4000_0000
            assert (plc.daemon.axes[0].reason is Reason.TASK_VELOCITY) is refused
            assert (drive.model.ramp.speed == 0) is refused
        fastest = 0.0
        while drive.model.ramp.speed:
            plc.exchange()
            fastest = max(fastest, drive.model.ramp.speed)
        assert fastest == pytest.approx(OWN_RPM, rel=0.01)
        assert drive.model.position_actual == pytest.approx(163_840, abs=2)
        plc.until(lambda: reached(plc), "target reached")


def test_telegram_9_homes_at_any_velocity() -> None:
    with gateway(9) as (plc, drive):
        plc.endpoint.set(0, {"SATZANW": 0x8023, "MDI_VELOCITY": 0x0400_0000, "STW1": 0x0C3F})
        plc.until(lambda: drive.node.read(0x6099, 1) == 188, "the homing speed")


MDI = {"MDI_TARPOS": 300_000, "MDI_VELOCITY": 30_000, "MDI_ACC": 0x4000, "MDI_DEC": 0x4000}
TASKS = {
    7: {"SATZANW": 1},
    110: {"SATZANW": 0x8000, "MDI_MOD": 1, "OVERRIDE": 0x4000, **MDI},
    111: {"POS_STW1": 0x8100, "OVERRIDE": 0x4000, **MDI},
}
BLOCKS = """[[axis.block]]
number = 1
position = 300_000
velocity = 30_000
[[axis.block]]
number = 2
position = 0
velocity = 29_999
"""


@pytest.mark.parametrize("number", TASKS)
def test_positioner_runs_tasks_at_the_velocity_of_the_drive(number: int) -> None:
    with gateway(number, POSITIONER + BLOCKS) as (plc, drive):
        axis_of = plc.daemon.axes[0]
        slower = {"SATZANW": 2} if number == 7 else {"MDI_VELOCITY": 29_999}
        plc.endpoint.set(0, TASKS[number])
        for values, reason in ((slower, Reason.TASK_VELOCITY), (TASKS[number], None)):
            plc.endpoint.set(0, {**values, "STW1": 0x043F})
            plc.exchange()
            plc.exchange()
            plc.endpoint.set(0, {"STW1": 0x047F})
            for _ in range(40):
                plc.exchange()
            assert axis_of.reason is reason
            assert (drive.model.ramp.speed == 0) is (reason is not None)
        fastest = 0.0
        while drive.model.ramp.speed:
            plc.exchange()
            fastest = max(fastest, drive.model.ramp.speed)
        assert fastest == pytest.approx(OWN_RPM, rel=0.01)
        plc.until(lambda: reached(plc), "target reached")


def test_changed_override_stops_the_drive_with_halt_and_a_warning() -> None:
    with gateway(111, POSITIONER) as (plc, drive):
        plc.endpoint.set(0, {**TASKS[111], "MDI_TARPOS": 1_000_000, "STW1": 0x043F})
        plc.exchange()
        plc.endpoint.set(0, {"STW1": 0x047F})
        plc.until(lambda: drive.model.ramp.speed > OWN_RPM / 2, "motion")
        plc.endpoint.set(0, {"OVERRIDE": 0x3FFF})
        plc.until(lambda: drive.model.controlword & 0x100, "Halt")
        plc.until(lambda: drive.model.ramp.speed == 0, "standstill")
        place = drive.model.position_actual
        plc.endpoint.set(0, {"OVERRIDE": 0x4000})
        for _ in range(100):
            plc.exchange()
        assert drive.model.position_actual == place
        assert plc.daemon.axes[0].reason is Reason.TASK_VELOCITY
        assert plc.value("WARN_CODE") == FaultNumber.POSITIONER
