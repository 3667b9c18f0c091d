"""Scan, axis test, can-utils and Wireshark on a real bus, and a network of the kernel with faults (``tc netem``)."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from pdgw.ds301.bus.interfaces import open_bus
from pdgw.gateway.commissioning.scan import Scan
from pdgw.gateway.configuration.environment import CanConfig
from pdgw.gateway.configuration.file import parse_config
from pdgw.gateway.links.new_frames import Verdict
from pdgw.gateway.service.status import snapshot
from pdgw.peers.drive import SimulatedDrive
from pdgw.tools.bus_task import complete, opened
from pdgw.tools.commissioning.axis_test import AxisTest, Choices
from tests.can.interfaces import Wire
from tests.can.plant import INHIBITED, Plant, axis_table, can_table
from tests.can.unhurried import UnhurriedPlatform
from tests.support.buses import PATIENCE_S, wait_for
from tests.support.cli import pdgw
from tests.support.gateways.recorded_daemon import record, recording
from tests.support.readers.captures import can_frames


def test_scan_over_a_short_queue_queries_every_node_id_and_finds_the_drive(line: Wire) -> None:
    platform = UnhurriedPlatform()
    with (
        SimulatedDrive(open_bus("socketcan", line.far), 5, loop=platform.loop),
        opened(CanConfig(interface="socketcan", channel=line.near, name=line.near), platform) as network,
    ):
        (found,) = complete(platform.loop, Scan(network, timeout_s=5.0).run)
        assert network.send_errors == 0
    platform.loop.close()
    assert found.node_id == 5
    assert found.lacks[1] == ""


def test_the_axis_test_turns_the_drive_and_finds_its_units_right(line: Wire) -> None:
    platform = UnhurriedPlatform()
    transport = "[transport]\ncyclic_port = 0\nacyclic_port = 0\nstatus_port = 0\n"
    config = parse_config("\n".join((can_table(line.near), axis_table(1, line.near), transport)))
    lines: list[str] = []
    test = AxisTest(config, 1, platform, lines.append, lambda wanted, answer: answer(wanted), Choices())
    with SimulatedDrive(open_bus("socketcan", line.far), 1, loop=platform.loop) as drive:
        outcome = complete(platform.loop, test.run)
        assert drive.model.ramp.speed == 0
    platform.loop.close()
    assert outcome.passed, lines


# -- can-utils and Wireshark ------------------------------------------------------------------------------------------


_LISTENERS = Path("/proc/net/can/rcvlist_all")
"""Interfaces with the sockets that hear every frame of them."""
ENABLE = re.compile(r"201#\w*0F00")
"""Enable Operation in the RPDO of node 1."""


def test_candump_sees_what_the_gateway_records_and_tshark_reads_both(line: Wire, tmp_path: Path) -> None:
    plant = Plant(can_table(line.near), axis_table(1, line.near))
    plant.drive(line.far)
    seen = tmp_path / "candump.log"
    record(plant.daemon, tmp_path)
    with seen.open("w") as output, subprocess.Popen(["candump", "-L", line.near], stdout=output) as candump:
        try:
            wait_for(lambda: line.near in _LISTENERS.read_text(), "candump listens")

            def sequence() -> None:
                plant.turn()
                plant.until(lambda: ENABLE.search(seen.read_text()), "candump has seen it")
                plant.stays(plant.turns, "turns on")

            plant.run_steps(sequence)
        finally:
            candump.terminate()
    recorded = Path(recording(tmp_path))
    frames = [text.split()[2] for text in seen.read_text().splitlines()]
    own = [f"{cob_id:03X}#{data.hex().upper()}" for cob_id, data in can_frames(recorded)]
    common = set(frames) & set(own)
    assert "000#0101" in common, "NMT start"
    assert any(ENABLE.fullmatch(frame) for frame in common), "Enable Operation"
    decoded = pdgw("decode", str(seen), "--stats")
    assert decoded.returncode == 0, decoded.stderr
    if shutil.which("tshark") is None:
        pytest.skip("tshark is not installed")
    for path, found in ((seen, frames), (recorded, own)):
        fields = ["tshark", "-r", str(path), "-Y", "can", "-T", "fields", "-e", "can.id"]
        shown = subprocess.run(fields, capture_output=True, text=True, check=True, timeout=PATIENCE_S)
        assert len(shown.stdout.splitlines()) == len(found)


def test_cansend_can_take_a_node_out_of_operation_and_the_axis_stops(line: Wire) -> None:
    plant = Plant(can_table(line.near), axis_table(1, line.near))
    drive = plant.drive(line.far)

    def sequence() -> None:
        plant.turn()
        plant.outside(lambda: subprocess.run(["cansend", line.far, "000#8001"], check=True, timeout=PATIENCE_S))
        plant.until(lambda: plant.state() != 0x07, "the axis is not in operation")
        plant.until(lambda: drive.model.velocity_actual == 0, "standstill")
        plant.until(lambda: plant.state() == INHIBITED, "the gateway has it again")
        plant.stays(lambda: plant.state() == INHIBITED, "the ON that is still 1 starts nothing")
        plant.turn()

    plant.run_steps(sequence)


# -- a network that delays, loses, repeats and reorders frames of the PLC ---------------------------------------------


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
        return plant.daemon.link.endpoint.counts.frames[verdict]

    def sequence() -> None:
        plant.turn()
        plant.outside(lambda: network("delay", "200ms", "150ms", "loss", "5%", "duplicate", "5%"))
        plant.until(lambda: counted(Verdict.STALE) > 5, "copies, and frames that others have overtaken")
        plant.turn()
        plant.outside(lambda: network("delay", "5s"))
        plant.until(lambda: drive.model.velocity_actual == 0, "frames of 5 s ago do not keep it turning")
        plant.until(lambda: counted(Verdict.TOO_OLD), "frames of 5 s ago arrive")
        plant.outside(lambda: network("delay", "1ms"))
        plant.until(lambda: plant.plc.value("ZSW1") != -1, "new frames count again")
        plant.stays(lambda: drive.model.velocity_actual == 0, "nothing old starts it", 6)
        assert 0.1 < snapshot(plant.daemon)["age_times"]["max_s"] <= LIMIT_S
        plant.turn()

    plant.run_steps(sequence)
