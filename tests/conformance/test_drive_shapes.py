"""Telegrams with every variant of a simulated drive, from every latency: each follows or is rejected with the right reason.

``make conformance`` also has other latencies, and the variants that need seconds.
"""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from pdgw.base.durations import SECOND
from pdgw.ds301.node.node import NodeStatus
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.peers.drive import SHAPES, shape
from tests.conformance.rig import COMPLETE, DriveRig, drive
from tests.support.drives.latency import draw_latency
from tests.support.gateways.daemon import axis, configuration, running, world_of

TELEGRAMS = (1, 3, 9, 100)
SEEDS = range(5 if COMPLETE else 1)
"""Each gives the drives other latencies."""
SLOW = () if COMPLETE else ("slow-sdo", "frozen")
"""Variants left to ``make conformance``: they need seconds."""
_ONLINE_NS = 300 * SECOND
"""A drive that answers each SDO after half a second gets hundreds of them."""
_LACKS = "not an object of this drive"
_OF_THE_ENGEL_LIKE = ("engel", "synchronous", "endless")
REFUSALS: Mapping[tuple[str, int], str] = {
    **{(name, 100): _LACKS for name in SHAPES if name not in _OF_THE_ENGEL_LIKE},
    **{("unguarded", number): "guarding of the gateway by the drive" for number in (1, 3, 9)},
    **{(name, 9): "modes of the drive" for name in ("vl", "inverter", "csv", "csp")},
    **{("csp", number): _LACKS for number in (1, 3)},
    ("no-range", 9): "set rated_acceleration_rpm_s",
}
"""A part of the reason of rejection, by variant and telegram. Without an entry the drive must move."""
_NAMES = [name for name in SHAPES if name not in SLOW]
_IN_TURN = [(name, number) for place, name in enumerate(_NAMES) for number in ((1, 3)[place % 2], 9)]
DRIVEN = (
    [(name, number) for name in _NAMES for number in TELEGRAMS]
    if COMPLETE
    else [*_IN_TURN, *((name, 100) for name in (*_OF_THE_ENGEL_LIKE, "rpm"))]
)
"""Variants with telegrams; without ``make conformance`` each with 9 and with 1 or 3, and one that lacks objects of 100."""


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("name", "number"), DRIVEN)
def test_drive_of_each_shape_moves_as_commanded_or_is_rejected(name: str, number: int, seed: int) -> None:
    with running(configuration(axis(1, telegram_number=number, more="")), seed=seed) as daemon:
        latency = draw_latency(world_of(daemon).chance(f"{name} {number}"))
        print(latency)
        rig = DriveRig(daemon, drive(daemon, shape=shape(name), latency=latency))
        rig.device.start()
        # The PLC waits: the drive comes online without it, which takes minutes for a slow one.
        rig.loop.until(lambda: rig.axis.drive.generation or _refusal(rig), "the drive", _ONLINE_NS)
        rig.reaches(lambda: _refusal(rig) or rig.plc.actuals[0])
        if expected := REFUSALS.get((name, number)):
            rig.until(lambda: expected in _refusal(rig), expected)
            return
        rig.enable()
        rig.move()
        if not rig.reaches(rig.moved):  # a difference that the gateway finds while the drive turns stops it once
            rig.enable()
            rig.move()
            rig.until(rig.moved, f"moved ({_refusal(rig)})")


def _refusal(rig: DriveRig) -> str:
    """Why the axis is not in operation; empty if there is no reason."""
    client = rig.axis.drive
    if client.status is NodeStatus.REFUSED:
        return client.status_text
    reference = [item.text for item in rig.axis.faults if item.number == FaultNumber.REFERENCE]
    return reference[-1] if reference else ""
