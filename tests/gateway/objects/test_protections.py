"""Each protection of an axis is active, or says what it lacks; status and ``pdgw config check`` agree."""

from __future__ import annotations

from random import Random

import pytest

from pdgw.gateway.axis.executors.positions.tasks import PositionerExecutor
from pdgw.gateway.axis.telegrams import DRIVE_TELEGRAMS
from pdgw.gateway.motion.basic_positioner import BasicPositioner
from pdgw.gateway.objects.protections import Protection, protections
from pdgw.gateway.service.status import snapshot
from pdgw.tools.commands.commissioning.config import _start
from pdgw.tools.output.status_text import object_lines, status_lines
from tests.support.documents.situations import run_out
from tests.support.gateways.daemon import OFF, ON, SIMULATED_POSITIONER, Plc, axis, configuration, running

_POSITIONER = axis(1, telegram_number=111, more=SIMULATED_POSITIONER)
_LIMITS = "-1000000 to 1000000 LU"


def named(found: list[Protection]) -> dict[str, Protection]:
    return {item.name: item for item in found}


@pytest.mark.parametrize("number", sorted(DRIVE_TELEGRAMS))
def test_check_of_the_file_and_status_name_the_same_protections(number: int) -> None:
    dsc = 'dsc = "speed"\nfollowing_window = 10000\n' if number in (5, 6, 105, 106) else ""
    more = dsc + (SIMULATED_POSITIONER if number in {7, 110, 111, 112} else "simulate = true")
    config = configuration(axis(1, telegram_number=number, more=more))
    checked = [line.removeprefix("axis 1: ") for line in _start(config)]
    with running(config) as daemon:
        before = protections(daemon.axes[0])
        assert checked == [f"{item.name}: {item.text}" for item in before]
        plc = Plc(daemon, [number])
        plc.until(lambda: daemon.axes[0].good, "online")
        after = protections(daemon.axes[0])
        document = snapshot(daemon)
    assert [item.name for item in after] == [item.name for item in before]
    assert all(new.active for old, new in zip(before, after, strict=True) if old.active), "the file makes it active"
    assert [(item["name"], item["text"]) for item in document["axes"][0]["protections"]] == [
        (item.name, item.text) for item in after
    ]
    text = " ".join(object_lines(document, 1, 400))
    assert all(f"{item.name}: {item.text}" in text for item in after)


@pytest.mark.parametrize("seed", range(5))
def test_software_limits_are_active_exactly_while_they_are_watched(seed: int) -> None:
    random = Random(seed)
    with running(configuration(_POSITIONER)) as daemon:
        plc, executor = Plc(daemon, [111]), daemon.axes[0].machine.executor
        assert isinstance(executor, PositionerExecutor)
        assert isinstance(executor.positioner, BasicPositioner)
        for _ in range(8):
            plc.endpoint.set(0, {"STW1": random.choice((OFF, ON & ~0x40)), "POS_STW2": random.choice((0, 2, 0x4000))})
            plc.exchange(50)
            found = named(protections(daemon.axes[0]))["software limits"]
            assert found.active is (executor.positioner.travel.limits is not None)


def test_axis_in_operation_shows_its_inactive_software_limits_in_one_line() -> None:
    with running(configuration(_POSITIONER)) as daemon:
        plc = Plc(daemon, [111])
        plc.endpoint.set(0, {"POS_STW1": 0x8100, "OVERRIDE": 0x4000})
        plc.endpoint.set(0, {"STW1": 0x043E})
        run_out(plc)
        plc.endpoint.set(0, {"STW1": 0x043F})
        run_out(plc)
        plc.endpoint.set(0, {"POS_STW2": 2})
        run_out(plc)
        (line,) = [line for line in status_lines(snapshot(daemon), 400) if line.startswith("axis 1: In operation")]
        assert "software limits not active" in line
        assert f"not active: {_LIMITS}; needs POS_STW2.14 = 1" in " ".join(object_lines(snapshot(daemon), 1, 400))
        plc.endpoint.set(0, {"POS_STW2": 0x4000})
        run_out(plc)
        (line,) = [line for line in status_lines(snapshot(daemon), 400) if line.startswith("axis 1: In operation")]
        assert "not active" not in line
        assert named(protections(daemon.axes[0]))["software limits"].text == f"active: {_LIMITS}"
