"""A network of the kernel that delays, loses, repeats and reorders the frames of the PLC (``tc netem``)."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator

import pytest

from pdgw.gateway.links.new_frames import Verdict
from pdgw.gateway.service.status import snapshot
from tests.can.interfaces import Wire
from tests.can.plant import Plant, axis_table, can_table
from tests.support.buses import PATIENCE_S

GATEWAY, PLC = "192.0.2.1", "192.0.2.2"
"""Not loopback, so the gateway expects late frames; both addresses are on lo."""
LISTEN = f'listen = "{GATEWAY}"\npeer = "{PLC}"\nwatchdog_factor = 50\n'
LIMIT_S = 2
"""Twice the watchdog time."""


def run(*words: str) -> None:
    subprocess.run(words, check=True, timeout=PATIENCE_S)


def network(*disturbances: str) -> None:
    """Frames that are on their way keep their time."""
    run("tc", "qdisc", "replace", "dev", "lo", "root", "netem", *disturbances)


@pytest.fixture
def addresses() -> Iterator[None]:
    for address in (GATEWAY, PLC):
        run("ip", "address", "add", f"{address}/32", "dev", "lo")
    network("delay", "0ms")
    yield
    run("tc", "qdisc", "del", "dev", "lo", "root")
    for address in (GATEWAY, PLC):
        run("ip", "address", "del", f"{address}/32", "dev", "lo")


@pytest.mark.usefixtures("addresses")
def test_frames_that_a_network_delays_loses_and_repeats_start_no_drive(line: Wire) -> None:
    plant = Plant(can_table(line.near), axis_table(1, line.near), plc=PLC, listen=LISTEN)
    drive = plant.drive(line.far)

    def counted(verdict: Verdict) -> int:
        return plant.daemon.link.endpoint.counters[verdict]

    def sequence() -> None:
        plant.turn()
        plant.outside(lambda: network("delay", "200ms", "150ms", "loss", "5%", "duplicate", "5%"))
        plant.until(lambda: counted(Verdict.STALE) > 5, "copies, and frames that others have overtaken")
        plant.turn()
        plant.outside(lambda: network("delay", "5s"))
        plant.until(lambda: drive.model.velocity_actual == 0, "frames of 5 s ago do not keep it turning")
        plant.until(lambda: counted(Verdict.TOO_OLD), "frames of 5 s ago arrive")
        plant.outside(lambda: network("delay", "1ms"))
        plant.until(lambda: plant.state() is not None, "new frames count again")
        plant.stays(lambda: drive.model.velocity_actual == 0, "nothing old starts it", 6)
        assert 0.1 < snapshot(plant.daemon)["age_times"]["max_s"] <= LIMIT_S
        plant.turn()

    plant.play(sequence)
