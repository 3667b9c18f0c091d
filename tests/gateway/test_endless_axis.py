"""Gateways with endless axes, or with drives that end: what the log and the status say, and positions over the wrap."""

from __future__ import annotations

import logging

import pytest

from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.motion.modulo import difference
from pdgw.gateway.objects.axis_chain import notes
from pdgw.gateway.service.status import axis_status
from pdgw.peers.drive import SimulatedDrive, shape
from pdgw.profidrive.signals import signal
from tests.support.gateways.daemon import (
    POSITIONER,
    Plc,
    axis,
    configuration,
    drive_of,
    online,
    operating,
    running,
    world_of,
)

COUNTS = 4096
FREE = "".join(line for line in POSITIONER.splitlines(keepends=True) if "software_limits" not in line)
"""A positioner without software limits."""
ENDS = "positions end at 607Bh -500000 to 500000"
UNCONFIRMED = "positions wrap at 607Bh -500000 to 500000, as CiA 402 says (not confirmed: range_is_limit of the family)"


def drive(daemon: Daemon, name: str) -> SimulatedDrive:
    return world_of(daemon).drive("world", 1, shape=shape(name))


@pytest.mark.parametrize(
    ("name", "number", "said"),
    [
        ("engel", 111, f"{ENDS}: 122.1 turns forward, 122.1 turns backward"),
        ("engel", 9, f"{ENDS}: 122.1 turns forward, 122.1 turns backward"),
        ("rpm", 111, UNCONFIRMED),
        ("endless", 111, ""),
        ("engel", 1, ""),
    ],
)
def test_bring_up_says_where_positions_end_or_that_their_wrap_is_not_confirmed(
    name: str, number: int, said: str, caplog: pytest.LogCaptureFixture
) -> None:
    keys = 'counts_per_revolution = 4096\nacceleration_unit = "rpm/s"\n' if name == "rpm" else ""
    with running(configuration(axis(1, telegram_number=number, more=keys + (FREE if number == 111 else "")))) as daemon:
        drive(daemon, name)
        with caplog.at_level(logging.INFO):
            online(daemon)
            Plc(daemon, [number]).exchange(20)
        (item,) = daemon.axes
        assert [line for line in caplog.messages if "positions " in line] == ([f"axis 1: {said}"] if said else [])
        assert notes(item) == ([said] if said and number != 9 else []), (
            "tasks of telegram 9 are fractions of this range"
        )
        assert any(line.startswith("positions ") for line in axis_status(item)["scaling"])


def test_sentence_of_a_feed_beyond_the_drive_names_its_range_and_the_remedy() -> None:
    with running(configuration(axis(1, telegram_number=111, more=f"simulate = true\n{FREE}"))) as daemon:
        plc = Plc(daemon, [111])
        plc.enable()
        for target in (1_500_000, 1_600_000):
            plc.endpoint.set(0, {"STW1": 0x043F, "POS_STW1": 0x8000, "OVERRIDE": 0x4000, "MDI_TARPOS": target})
            plc.endpoint.set(0, {"MDI_VELOCITY": 12_000, "MDI_ACC": 0x4000, "MDI_DEC": 0x4000})
            plc.exchange(5)
            plc.endpoint.set(0, {"STW1": 0x047F})
            plc.exchange(20)
            (item,) = daemon.axes
            assert item.outputs.reason is Reason.TASK_DRIVE_RANGE
            assert (
                f"end of the task {target} LU, allowed -1220703 to 1220703 (607Bh -500000 to 500000 of the drive)"
                in item.enable_status.sentence
            )
            assert "607Bh = 0/0" in item.enable_status.sentence


def test_simulated_axis_with_a_modulo_range_is_an_endless_shaft() -> None:
    more = f"simulate = true\n{FREE}modulo_range = 10000\n"
    with operating(configuration(axis(1, telegram_number=111, more=more))) as (daemon, plc):
        forward = signal("POS_STW1").word("MDI", "SETTING_UP", "POSITIVE_DIRECTION")
        plc.endpoint.set(0, {"STW1": 0x043F, "POS_STW1": forward, "OVERRIDE": 0x4000, "MDI_VELOCITY": 30_000})
        plc.endpoint.set(0, {"MDI_ACC": 0x4000, "MDI_DEC": 0x4000})
        plc.exchange(5)
        plc.endpoint.set(0, {"STW1": 0x047F})
        model = drive_of(daemon).model
        plc.until(lambda: model.position > 140 * COUNTS, "further than the slide")
        assert model.velocity_actual > 0
        assert not daemon.axes[0].faults


@pytest.mark.parametrize("rpm", [3000, -3000])
def test_speed_axis_turns_over_the_wrap_without_a_warning_and_its_position_counts_on(rpm: int) -> None:
    keys = "counts_per_revolution = 4096\n"
    with running(configuration(axis(1, telegram_number=3, more=keys))) as daemon:
        model = drive(daemon, "rpm").model
        plc = Plc(daemon, [3])
        plc.enable()
        plc.endpoint.set(0, {"NSOLL_B": (rpm << 30) // 3000})
        plc.until(lambda: abs(plc.value("NIST_B")) >= (1 << 30) - (1 << 20), "the speed")
        shown, begin, before = plc.value("G1_XIST1"), model.position, plc.value("G1_XIST1")
        while abs(model.position - begin) < 300 * COUNTS:
            plc.exchange()
            step = (plc.value("G1_XIST1") - before + (1 << 31)) % (1 << 32) - (1 << 31)
            assert 0 <= step * rpm // abs(rpm) < 2 * COUNTS
            before = plc.value("G1_XIST1")
        moved = (before - shown + (1 << 31)) % (1 << 32) - (1 << 31)
        assert abs(moved - (model.position - begin)) < COUNTS
        assert not daemon.axes[0].faults


@pytest.mark.parametrize("direction", [1, -1])
def test_dsc_by_positions_turns_over_607bh_without_a_change_of_direction(direction: int) -> None:
    """The PLC closes its position loop, 20 increments further in each cycle. G1_XIST1 counts on beyond the wrap."""
    keys = 'dsc = "position"\nfollowing_window = 4096\ncounts_per_revolution = 4096\nacceleration_unit = "inc/s2"\n'
    with running(configuration(axis(1, telegram_number=105, more=keys))) as daemon:
        simulated = drive(daemon, "csp")
        model = simulated.model
        model.zero = start = -490_000 * direction
        plc = Plc(daemon, [105])
        plc.enable()
        goal, speeds = -start, []
        while abs(model.machine_position) < 20_000:
            goal += 20 * direction
            plc.endpoint.set(0, {"XERR": difference(goal, plc.value("G1_XIST1")), "KPC": 20_000})
            plc.exchange()
            speeds.append(model.speed * direction)
        assert min(speeds) >= 0
        assert max(speeds) < 300
        assert abs(difference(goal, plc.value("G1_XIST1"))) < 200
        assert model.position_actual * direction < 0, "beyond the wrap"
