"""The table of supervisions: each has a legal habit of devices next to it, which trips nothing."""

from __future__ import annotations

import pytest

from pdgw.gateway.commissioning.supervisions import SUPERVISIONS, Measured
from pdgw.peers.habits import HABITS
from tests.long.documents.supervisions import NEAREST
from tests.support.gateways.daemon import OFF, ON, SIMULATED_POSITIONER, Plc, axis, configuration, drive_of, running

TASK = {
    "POS_STW1": 0x8000,
    "OVERRIDE": 0x4000,
    "MDI_TARPOS": 300,
    "MDI_VELOCITY": 6000,
    "MDI_ACC": 0x4000,
    "MDI_DEC": 0x4000,
}
"""A relative task of the positioner."""


def test_each_supervision_has_a_legal_habit_next_to_it() -> None:
    assert NEAREST.keys() == {item.name for item in SUPERVISIONS}
    assert {name for name in NEAREST.values() if "drive" not in HABITS[name].legal_for} == set()


def test_each_time_that_the_axis_test_measures_has_a_limit() -> None:
    assert [item.name for item in SUPERVISIONS if item.name in list(Measured) and item.limit] == list(Measured)


@pytest.mark.parametrize("name", NEAREST)
def test_a_legal_habit_at_its_limit_trips_no_supervision(name: str) -> None:
    """From power-on; off and on, a speed and a task, and off."""
    habit = HABITS[NEAREST[name]]
    values = {key: limits[1] for key, limits in habit.legal.items()}
    number = 111 if habit.name in {"acknowledge-late", "target-reached-late"} else 1
    more = SIMULATED_POSITIONER if number == 111 else "simulate = true"
    with running(
        configuration(axis(1, telegram_number=number, more=more)),
        before=lambda daemon: drive_of(daemon).do(lambda node: node.start_fault(habit.name, **values)),
    ) as daemon:
        plc = Plc(daemon, [number])
        plc.enable()
        if number == 1:
            for speed in (0x1000, -0x1000, 0):
                plc.turn(speed)
        else:
            plc.endpoint.set(0, TASK | {"STW1": ON & ~0x40})
            plc.exchange(20)
            plc.endpoint.set(0, {"STW1": ON})
            plc.exchange(1000)
            assert drive_of(daemon).shaft(0), "the task was carried out"
        plc.endpoint.set(0, {"STW1": OFF})
        plc.until(lambda: plc.state() == 0x01, "off")
        item = daemon.axes[0]
        assert [record.text for record in item.faults if not (habit.warns and record.is_warning)] == []
        assert item.drive.generation == 1
