"""Drives with wrong or contradicting units: the shaft turns at the commanded speed or not at all."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.profidrive.signals import signal
from tests.support.documents.situations import SLOW_PLC, run_out
from tests.support.drives.own_law_drive import Law, OwnLawDrive
from tests.support.gateways.daemon import (
    OFF,
    ON,
    Plc,
    axis,
    configuration,
    drive_of,
    online,
    operating,
    running,
    world_of,
)

RATED = 3000
PERCENT = 4
COMMANDED = RATED * PERCENT / 100
_NSOLL = signal("NSOLL_A")
ANSWERS = {(0x6080, 0): RATED}
RPM, TENTH_RPM, INCREMENTS = 0x00B4_4700, 0xFFB4_4700, 0x00B5_0300
PER_COUNT = 60 / 4096
"""rpm of one increment per second of an encoder with 4096."""


def ratio(index: int, numerator: int, denominator: int = 1) -> dict[tuple[int, int], int]:
    return {(index, 1): numerator, (index, 2): denominator}


@dataclass(frozen=True)
class Liar:
    """A drive, what its configuration says, and what has to become of it."""

    law: Law
    outcome: str
    """``right``, ``refused`` or ``stopped``."""
    said: str = ""
    """Part of the fault's text."""
    keys: str = ""
    later: Callable[[OwnLawDrive], object] | None = None
    """What happens to it half a second after it turns at the commanded speed."""


@dataclass
class Run:
    outcome: str
    text: str
    factor: float
    """Fastest speed to the commanded one."""
    seconds: float = 0.0
    """From the setpoint, or from what happened later, until the shaft slowed down."""


def _law(rpm_per_unit: float, *objects: dict[tuple[int, int], int], **more: object) -> Law:
    told = dict(ANSWERS)
    for item in objects:
        told |= item
    return Law(rpm_per_unit, objects=told, **more)  # type: ignore[arg-type]


def _rewrite(drive: OwnLawDrive) -> None:
    """Another tool writes 60A9h: what was a tenth of a unit is a whole one."""
    drive.do(lambda node: node.values.__setitem__((0x60A9, 0), RPM))
    drive.do(lambda node: setattr(node, "rpm_per_unit", 1.0))


LIARS = {
    "rpm, 608Fh alone": Liar(_law(1, ratio(0x608F, 4096), {(0x607F, 0): 3000}), "refused", "608Fh"),
    "rpm by 608Bh/608Ch, 6090h = 608Fh = 2^20": Liar(
        _law(1, {(0x608B, 0): 0, (0x608C, 0): 0xA4}, ratio(0x608F, 1 << 20), ratio(0x6090, 1 << 20), counts=1 << 20),
        "refused",
        "6090h",
    ),
    "Kollmorgen S300 by its manual": Liar(
        _law(
            1,
            {(0x608B, 0): 0, (0x608C, 0): 0xA4},
            ratio(0x608F, 1 << 20),
            ratio(0x6090, 1 << 20),
            counts=1 << 20,
            identity=(0x6A, 306),
            name="S300",
        ),
        "right",
    ),
    "Elmo Gold, 608Fh and 6092h as delivered": Liar(
        _law(
            PER_COUNT,
            ratio(0x608F, 1),
            ratio(0x6092, 1),
            ratio(0x6091, 1),
            {(0x607F, 0): 204_800},
            identity=(0x9A, 0x30924),
            name="Gold Drive",
        ),
        "refused",
        "counts_per_revolution",
    ),
    "counts by 608Fh, 6092h as delivered": Liar(
        _law(PER_COUNT, ratio(0x608F, 4096), ratio(0x6092, 1), {(0x607F, 0): 204_800}), "right"
    ),
    "counts, 6092h as delivered, nothing else": Liar(
        _law(PER_COUNT, ratio(0x6092, 1), ratio(0x6096, 1), {(0x607F, 0): 204_800}), "refused", "velocity_unit"
    ),
    "Kollmorgen AKD by its manual": Liar(
        _law(
            0.001,
            ratio(0x608F, 1 << 20),
            ratio(0x6091, 1),
            ratio(0x6092, 1 << 20),
            ratio(0x6096, 1),
            counts=1 << 20,
            identity=(0x6A, int.from_bytes(b"M006", "big")),
            name="M006",
        ),
        "right",
    ),
    "Kollmorgen AKD2G, of no family": Liar(
        _law(1, ratio(0x6090, 1 << 20), identity=(0x6A, 0x1111_0000), name="AKD2G-SPE"), "refused", "families"
    ),
    "608Fh 16 times too high": Liar(_law(PER_COUNT, ratio(0x608F, 65_536), {(0x607F, 0): 204_800}), "refused", "608Fh"),
    "60A9h = 0.1 rpm, rewritten to rpm meanwhile": Liar(
        _law(0.1, {(0x60A9, 0): TENTH_RPM}), "stopped", "60A9h was FFB44700h and is B44700h", later=_rewrite
    ),
    "FAULHABER MCLM, mm/s": Liar(
        _law(3.0, ratio(0x608F, 3000), {(0x607F, 0): 150_000}, identity=(0x147, 0), name="MCLM3006"),
        "refused",
        "velocity_unit",
    ),
    "Lexium 32, user units": Liar(
        _law(1, ratio(0x608F, 131_072), {(0x607F, 0): 6_553_600}, identity=(0x0800_005A, 0x16440), name="LXM32A"),
        "refused",
        "velocity_unit",
    ),
    "60A9h = rpm, 0.1 rpm in truth": Liar(_law(0.1, {(0x60A9, 0): RPM}, ratio(0x608F, 4096)), "stopped", "6064h"),
    "60A9h = 0.1 rpm, 6096h = rpm": Liar(
        _law(1, {(0x60A9, 0): TENTH_RPM}, ratio(0x608F, 4096), ratio(0x6096, 60, 4096), {(0x607F, 0): 3000}),
        "refused",
        "6096h",
    ),
    "6094h is rpm a unit, read as increments": Liar(
        _law(0.5, ratio(0x6094, 1, 2), ratio(0x608F, 4096), {(0x607F, 0): 6000}), "refused", "6094h"
    ),
    "6091h = 100, which rpm do not have": Liar(
        _law(1, {(0x60A9, 0): RPM}, ratio(0x6091, 100), {(0x607F, 0): 3000}), "refused", "6091h"
    ),
    "606Ch repeats the setpoint, the shaft turns 8 times as fast": Liar(
        _law(8, {(0x60A9, 0): RPM}, ratio(0x608F, 4096), shown=lambda rpm, target: target), "stopped", "6064h"
    ),
    "speed grows at a constant setpoint": Liar(
        _law(1, {(0x60A9, 0): RPM}, excess=lambda seconds: 1.0 + max(0.0, seconds - 1.5)), "stopped", "606Ch"
    ),
    "606Ch at twice the setpoint": Liar(_law(1, {(0x60A9, 0): RPM}, excess=lambda seconds: 2.0), "stopped", "606Ch"),
    "60A9h = rpm, the configuration says 0.1 rpm": Liar(
        _law(1, {(0x60A9, 0): RPM}), "refused", "60A9h", 'velocity_unit = "0.1 rpm"\n'
    ),
    "rpm, 607Fh and 608Fh of another drive": Liar(
        _law(1, ratio(0x608F, 4096), {(0x607F, 0): 204_800}), "stopped", "6064h"
    ),
    "velocity mode with 604Ch": Liar(_law(1 / 60, ratio(0x604C, 1, 60), vl=True), "refused", "604Ch"),
}


def run(liar: Liar) -> Run:
    """4 % of the speed from the PLC for four seconds; what the shaft did and what the gateway said."""
    with running(configuration(axis(1, more=liar.keys), transport=SLOW_PLC)) as daemon:
        drive = OwnLawDrive(world_of(daemon), "world", 1, liar.law)
        online(daemon)
        plc = Plc(daemon, [1])
        plc.endpoint.set(0, {"STW1": OFF})
        run_out(plc)
        plc.endpoint.set(0, {"STW1": ON, "NSOLL_A": _NSOLL.raw(PERCENT)})
        result = _watch(daemon, plc, drive, 4 * SECOND)
        if result.outcome == "turned" and liar.later is not None:
            liar.later(drive)
            result = _watch(daemon, plc, drive, 4 * SECOND)
        return result


def _watch(daemon: Daemon, plc: Plc, drive: OwnLawDrive, duration: int) -> Run:
    node, loop = drive.node, world_of(daemon).loop
    node.fastest = 0.0
    begun, moved, moving, departed = loop.now(), 0, 0, 0
    while loop.now() < begun + duration:
        plc.exchange()
        if node.rpm:
            moved = moved or loop.now()
            moving = loop.now()
        if abs(node.rpm) > 1.25 * COMMANDED:
            departed = departed or loop.now()
    text = "; ".join(fault.text for fault in daemon.axes[0].faults)
    factor = node.fastest / COMMANDED
    if not moved:
        return Run("refused", text, 0.0)
    if moving < begun + duration - 500 * MS:
        return Run("stopped", text, factor, (node.stopped_at - (departed or moved)) / SECOND)
    return Run("turned", text, abs(node.rpm) / COMMANDED)


@pytest.mark.parametrize("name", LIARS)
def test_drive_with_wrong_values_turns_as_commanded_or_not_at_all(name: str) -> None:
    liar = LIARS[name]
    found = run(liar)
    if liar.outcome == "right":
        assert found.outcome == "turned", found
        assert found.factor == pytest.approx(1, abs=0.01)
        return
    assert found.outcome == liar.outcome, found
    assert re.search(liar.said, found.text), found
    if found.outcome == "stopped":
        assert found.seconds < 1, found


def test_units_that_change_at_standstill_in_operation_are_noticed_before_motion() -> None:
    law = LIARS["60A9h = 0.1 rpm, rewritten to rpm meanwhile"].law
    with running(configuration(axis(1, more=""))) as daemon:
        drive = OwnLawDrive(world_of(daemon), "world", 1, law)
        online(daemon)
        plc = Plc(daemon, [1])
        for word in (OFF, ON):
            plc.endpoint.set(0, {"STW1": word})
            plc.exchange(200)
        assert daemon.axes[0].enable_status.broken is None
        _rewrite(drive)
        plc.exchange(500)
        assert [fault.number for fault in daemon.axes[0].faults] == [128]
        plc.endpoint.set(0, {"STW1": ON, "NSOLL_A": _NSOLL.raw(PERCENT)})
        drive.node.fastest = 0.0
        plc.exchange(200)
        assert drive.node.fastest == 0.0


def test_range_of_positions_that_changes_in_operation_stops_the_drive() -> None:
    """At the panel of the drive: positions then start again at another value (607Bh)."""
    with operating(configuration(axis(1, more="simulate = true\n"))) as (daemon, plc):
        node = drive_of(daemon).node
        node.values[0x607B, 2] = node.read(0x607B, 2) // 2
        plc.until(lambda: daemon.axes[0].faults, "a fault")
        fault = daemon.axes[0].faults[0]
        assert fault.number == 128
        assert "607Bh/2 was" in fault.text
        plc.until(lambda: not daemon.axes[0].powered, "no power")
