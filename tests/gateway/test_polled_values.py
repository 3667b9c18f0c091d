"""A drive whose speed or other values no TPDO has: the answers by SDO are late or lost, and an old one counts for nothing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.eds.writer import write_eds
from pdgw.dsp402.drive.images import DEMAND_UNKNOWN
from pdgw.dsp402.states import State
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.peers.drive import Shape, SimulatedDrive, shape
from pdgw.peers.plc.engine import Engine
from pdgw.peers.plc.scenario_file import load_scenario
from pdgw.tools.commands.commissioning.config import app
from tests.gateway.test_motion_daemon import HOME_SET, SCENARIO
from tests.support.gateways.daemon import OFF, POSITIONER, Plc, axis, configuration, online, running, world_of

FULL = 0x4000
OFF3 = 0x047B
VOLTAGE = 0x0002
"""Controlword.1."""
FAST = 0x3300
"""NSOLL_A of 2391 rpm."""
LATE = ("sdo-answers-of-object-late", {"delay_ms": 400})
LOST = ("sdo-answers-of-object-missing", {})


def without_pdo(*indices: int, base: str = "rpm") -> Shape:
    """A drive that has these objects in no PDO."""
    like = shape(base)
    own = {spec.index: spec for spec in like.has}
    for spec in like.objects():
        if spec.index in indices:
            entries = tuple(replace(entry, pdo=False) for entry in spec.entries)
            own[spec.index] = replace(spec, entries=entries)
    return replace(like, has=tuple(own.values()))


SPEED_BY_SDO = without_pdo(0x606C)


@contextmanager
def polled(
    more: str = "", number: int = 1, *, like: Shape = SPEED_BY_SDO
) -> Iterator[tuple[Daemon, SimulatedDrive, Plc]]:
    """A drive in operation, with a speed that is read by SDO."""
    with running(configuration(axis(1, telegram_number=number, more=more), transport="cycle_time_ms = 4")) as daemon:
        drive = world_of(daemon).drive("world", 1, shape=like)
        online(daemon)
        plc = Plc(daemon, [number])
        plc.enable()
        yield daemon, drive, plc


def _for(plc: Plc, nanoseconds: int) -> None:
    plc.exchange(nanoseconds // plc.daemon.cycle_ns)


def _faults(daemon: Daemon) -> list[int]:
    return [fault.number for fault in daemon.axes[0].faults]


def _turn(plc: Plc) -> None:
    plc.endpoint.set(0, {"NSOLL_A": FAST})
    plc.until(lambda: abs(plc.value("NIST_A") - FAST) <= 10, "the speed")


def _begin(drive: SimulatedDrive, fault: tuple[str, dict[str, int]]) -> None:
    drive.do(lambda node: node.start_fault(fault[0], **fault[1]))


def test_the_speed_of_this_drive_is_read_by_sdo() -> None:
    with polled() as (daemon, _, _):
        plan = daemon.axes[0].drive.plan
        assert plan is not None
        assert "read by SDO every 100 ms: Velocity Actual Value 606Ch" in plan.lines


@pytest.mark.parametrize("disturbance", [LATE, LOST], ids=["late", "lost"])
def test_off1_with_late_or_lost_answers_reports_no_fault_if_the_drive_brakes(
    disturbance: tuple[str, dict[str, int]],
) -> None:
    with polled() as (daemon, drive, plc):
        _turn(plc)
        _begin(drive, disturbance)
        plc.endpoint.set(0, {"STW1": OFF})
        _for(plc, 600 * MS)
        drive.do(lambda node: node.end_fault())
        plc.until(lambda: drive.model.state is not State.OPERATION_ENABLED, "the end of the ramp")
        assert abs(drive.model.ramp.speed) <= 30
        _for(plc, SECOND)
        assert plc.state() == 0x01
        assert _faults(daemon) == []


def test_off1_with_an_old_standstill_brakes_the_shaft_before_power_goes() -> None:
    with polled() as (daemon, drive, plc):
        _for(plc, SECOND)
        plc.endpoint.set(0, {"NSOLL_A": FULL})
        _begin(drive, LOST)
        plc.until(lambda: drive.model.ramp.speed > 2300, "the speed")
        plc.endpoint.set(0, {"STW1": OFF})
        _for(plc, 40 * MS)
        drive.do(lambda node: node.end_fault())
        plc.until(lambda: drive.model.state is not State.OPERATION_ENABLED, "the end of the ramp")
        assert abs(drive.model.ramp.speed) <= 30
        assert _faults(daemon) == []


def test_a_standstill_needs_two_answers_to_requests_after_the_order() -> None:
    with polled() as (daemon, drive, plc):
        _for(plc, SECOND)
        asked = daemon.axes[0].machine.inputs.speed_asked_ns
        plc.endpoint.set(0, {"STW1": OFF})
        requests = set()
        while drive.model.state is State.OPERATION_ENABLED:
            plc.exchange()
            requests.add(daemon.axes[0].machine.inputs.speed_asked_ns)
        assert len(requests - {asked}) == 2
        assert _faults(daemon) == []


def test_disable_voltage_after_a_quick_stop_is_commanded_until_the_drive_is_off() -> None:
    """The drive stays in Quick Stop Active (605Ah), and its brake needs some time to close."""
    with polled() as (_, drive, plc):
        _turn(plc)
        drive.do(lambda node: node.start_fault("quick-stop-stays"))
        drive.model.transition_ms[State.QUICK_STOP_ACTIVE, State.SWITCH_ON_DISABLED] = 300
        plc.endpoint.set(0, {"STW1": OFF3})
        plc.until(lambda: not drive.model.controlword & VOLTAGE, "Disable Voltage")
        received = set()
        while drive.model.state is State.QUICK_STOP_ACTIVE:
            plc.exchange()
            received.add(drive.model.controlword & VOLTAGE)
        assert received == {0}
        assert drive.model.state is State.SWITCH_ON_DISABLED


@pytest.mark.parametrize("disturbance", [None, LATE], ids=["prompt", "late"])
def test_a_drive_with_a_polled_speed_that_ignores_off1_is_stopped_by_nmt(
    disturbance: tuple[str, dict[str, int]] | None,
) -> None:
    with polled() as (daemon, drive, plc):
        _turn(plc)
        if disturbance is not None:
            _begin(drive, disturbance)
            _for(plc, SECOND)
        drive.do(lambda node: node.start_fault("deaf"))
        plc.endpoint.set(0, {"STW1": OFF})
        plc.until(lambda: FaultNumber.STOP_IGNORED in _faults(daemon), "the fault", 2)


def test_a_ramp_with_an_unknown_speed_ends_with_quick_stop_after_twice_the_stop_time() -> None:
    with polled("stop_time_ms = 1500\nsdo_timeout_ms = 2000") as (daemon, drive, plc):
        _turn(plc)
        _begin(drive, ("sdo-answers-of-object-late", {"delay_ms": 1500}))
        _for(plc, 2 * SECOND)
        plc.endpoint.set(0, {"STW1": OFF})
        _for(plc, 3 * SECOND)
        assert drive.model.state is State.OPERATION_ENABLED
        assert _faults(daemon) == []
        _for(plc, 500 * MS)
        assert drive.model.state is not State.OPERATION_ENABLED
        assert _faults(daemon) == [FaultNumber.STOP_IGNORED]
        assert "606Ch by SDO is" in daemon.axes[0].faults[0].text


def test_bits_of_the_speed_are_0_while_it_is_unknown() -> None:
    bits = 1 << 8 | 1 << 10
    with polled() as (_, drive, plc):
        _turn(plc)
        _for(plc, SECOND)
        assert plc.value("ZSW1") & bits == bits
        _begin(drive, LOST)
        _for(plc, 250 * MS)
        assert plc.value("ZSW1") & bits == bits
        _for(plc, 200 * MS)
        assert plc.value("ZSW1") & bits == 0


def test_fast_changes_of_the_speed_between_late_answers_contradict_no_position() -> None:
    """Telegram 3 has the position in a TPDO, which is newer than the speed."""
    with polled(number=3, more="counts_per_revolution = 4096") as (daemon, drive, plc):
        _begin(drive, LATE)
        for speed in (FULL, 0, FULL, 0):
            plc.endpoint.set(0, {"NSOLL_B": speed << 16})
            _for(plc, 1200 * MS)
        assert _faults(daemon) == []


# -- other values that decide -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "indices", [(0x606C,), (0x6064,), (0x606C, 0x6064, 0x6061)], ids=lambda item: f"{item[-1]:04X}h"
)
def test_the_scenario_of_the_positioner_passes_with_values_by_sdo(indices: tuple[int, ...]) -> None:
    with running(configuration(axis(1, telegram_number=111, more=POSITIONER))) as daemon:
        world_of(daemon).drive("world", 1, shape=without_pdo(*indices, base="synchronous"))
        plc = Plc(daemon, [111])
        engine = Engine(load_scenario(SCENARIO), plc.endpoint)
        while not engine.finished:
            engine.step(plc.loop.now())
            plc.exchange()
        assert engine.passed, [(result.name, result.measured) for result in engine.results if not result.passed]


def test_a_homing_ends_with_a_position_that_was_requested_after_it() -> None:
    with polled(number=9, like=without_pdo(0x6064), more="counts_per_revolution = 4096") as (daemon, drive, plc):
        drive.do(lambda node: setattr(node.model, "machine_position", 10_000.0))
        _for(plc, SECOND)
        assert drive.model.position_actual == 10_000
        inputs = daemon.axes[0].machine.inputs
        before = inputs.feedback.position_actual
        drive.do(lambda node: node.start_fault("sdo-answers-of-object-late", index=0x6064, delay_ms=300))
        plc.endpoint.set(0, {"STW1": 0x0C3F, "SATZANW": 35, "MDI_VELOCITY": 1 << 28})
        plc.until(lambda: plc.value("ZSW1") & HOME_SET, "home position set")
        assert (before, inputs.feedback.position_actual) == (10_000, 0)


@pytest.mark.parametrize(
    ("index", "attribute", "unknown"),
    [(0x606B, "velocity_demand", DEMAND_UNKNOWN), (0x6078, "current_actual", 0)],
    ids=["606Bh", "6078h"],
)
def test_an_old_torque_or_demand_value_is_unknown(index: int, attribute: str, unknown: int) -> None:
    with polled(number=102, like=without_pdo(index)) as (daemon, drive, plc):
        feedback = daemon.axes[0].drive.feedback
        drive.do(lambda node: node.start_fault("sdo-answers-of-object-missing", index=index))
        _for(plc, 100 * MS)
        setattr(feedback, attribute, 700)
        _for(plc, 100 * MS)
        assert getattr(feedback, attribute) == 700
        _for(plc, 200 * MS)
        assert getattr(feedback, attribute) == unknown


# -- what the user is told --------------------------------------------------------------------------------------------------


def test_config_check_prints_the_times_that_a_speed_by_sdo_results_in(tmp_path: Path) -> None:
    for name, lines in (("speed-by-sdo", 1), ("rpm", 0)):
        sheet = tmp_path / f"{name}.eds"
        sheet.write_bytes(write_eds(shape(name).info, shape(name).objects()).encode())
        file = tmp_path / "gateway.toml"
        file.write_text(
            f'[can]\ninterface = "virtual"\n[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = 1\neds = "{sheet}"\n'
        )
        result = CliRunner().invoke(app, ["check", str(file)])
        assert result.exit_code == 0, result.output
        assert result.output.count("the only speed is") == lines
        if lines:
            assert (
                "DO 1: the only speed is 606Ch by SDO. Longest time from a stop to what is seen of it, with answers at once: "
                "standstill 0.24 s, fault 125 0.548 s; with answers that take 1 s: standstill 3 s, fault 125 3.31 s. Without "
                "answers the drive is lost after 1.8 s" in result.output
            )


@pytest.mark.parametrize(("delay_ms", "standstill", "fault"), [(0, 240, 548), (900, 3000, 3310)])
def test_standstill_and_fault_come_within_the_times_of_config_check(delay_ms: int, standstill: int, fault: int) -> None:
    more = "sdo_timeout_ms = 2000"
    with polled(more) as (daemon, drive, plc):
        if delay_ms:
            _begin(drive, ("sdo-answers-of-object-late", {"delay_ms": delay_ms}))
        _for(plc, 3 * SECOND)
        plc.endpoint.set(0, {"STW1": OFF})
        plc.until(lambda: drive.model.state is not State.OPERATION_ENABLED, "standstill", (standstill + 12) / 1000)
        plc.enable()
        _turn(plc)
        _for(plc, 3 * SECOND)
        drive.do(lambda node: node.start_fault("deaf"))
        plc.endpoint.set(0, {"STW1": OFF})
        plc.until(lambda: FaultNumber.STOP_IGNORED in _faults(daemon), "the fault", (fault + 12) / 1000)


def test_a_limit_bit_of_before_a_task_may_be_its_way_out_while_the_standstill_is_unknown() -> None:
    """The task comes before two answers have shown the standstill, and the drive begins late: its brake opens."""
    task = {"OVERRIDE": 0x4000, "MDI_TARPOS": 20_000, "MDI_VELOCITY": 12_000, "MDI_ACC": 0x4000, "MDI_DEC": 0x4000}
    with running(configuration(axis(1, telegram_number=111, more=POSITIONER), transport="cycle_time_ms = 4")) as daemon:
        drive = world_of(daemon).drive("world", 1, shape=without_pdo(0x606C, base="synchronous"))
        _begin(drive, ("limit-bit-in-operation", {}))
        drive.model.opening_ms = 1500
        online(daemon)
        plc = Plc(daemon, [111])
        plc.endpoint.set(0, {"STW1": 0x043E, "POS_STW1": 0x8100, **task})
        plc.exchange()
        plc.endpoint.set(0, {"STW1": 0x043F})
        plc.until(lambda: plc.value("ZSW1") & 0x4, "operation")
        plc.endpoint.set(0, {"STW1": 0x047F})
        _for(plc, 4 * SECOND)
        assert _faults(daemon) == []
        assert drive.model.ramp.speed == 0
        assert plc.value("ZSW1") & 0x400, "it has reached its target"
