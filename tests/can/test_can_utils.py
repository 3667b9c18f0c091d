"""Common tools beside the gateway: can-utils on its bus, Wireshark on its recording."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from pdgw.tools.service.run_log import CanRecorder
from tests.can.interfaces import Wire
from tests.can.plant import INHIBITED, Plant, axis_table, can_table
from tests.support.buses import PATIENCE_S, wait_for
from tests.support.cli import pdgw

_LISTENERS = Path("/proc/net/can/rcvlist_all")
"""Interfaces with the sockets that hear every frame of them."""
ENABLE = re.compile(r"201#\w*0F00")
"""Enable Operation in the RPDO of node 1."""


def test_candump_sees_what_the_gateway_records_and_tshark_reads_both(line: Wire, tmp_path: Path) -> None:
    plant = Plant(can_table(line.near), axis_table(1, line.near))
    plant.drive(line.far)
    seen, recorded = tmp_path / "candump.log", tmp_path / "can.log"
    recorder = CanRecorder(recorded)
    plant.daemon.networks[line.near].listeners.append(lambda message: recorder.record(line.near, message))
    with seen.open("w") as output, subprocess.Popen(["candump", "-L", line.near], stdout=output) as candump:
        try:
            wait_for(lambda: line.near in _LISTENERS.read_text(), "candump listens")

            def sequence() -> None:
                plant.turn()
                plant.until(lambda: ENABLE.search(seen.read_text()), "candump has seen it")
                plant.stays(plant.turns, "turns on")

            plant.play(sequence)
        finally:
            candump.terminate()
    recorder.stop()
    frames = [{text.split()[2] for text in path.read_text().splitlines()} for path in (seen, recorded)]
    common = frames[0] & frames[1]
    assert "000#0101" in common, "NMT start"
    assert any(ENABLE.fullmatch(frame) for frame in common), "Enable Operation"
    decoded = pdgw("decode", str(seen), "--stats")
    assert decoded.returncode == 0, decoded.stderr
    if shutil.which("tshark") is None:
        pytest.skip("tshark is not installed")
    for path in (seen, recorded):
        fields = ["tshark", "-r", str(path), "-T", "fields", "-e", "can.id", "-e", "data.data"]
        shown = subprocess.run(
            fields, capture_output=True, text=True, check=True, timeout=PATIENCE_S
        ).stdout.splitlines()
        assert len(shown) == len(path.read_text().splitlines())


def test_cansend_can_take_a_node_out_of_operation_and_the_axis_stops(line: Wire) -> None:
    plant = Plant(can_table(line.near), axis_table(1, line.near))
    drive = plant.drive(line.far)

    def sequence() -> None:
        plant.turn()
        plant.outside(lambda: subprocess.run(["cansend", line.far, "000#8001"], check=True, timeout=PATIENCE_S))
        plant.until(lambda: plant.state() != 0x07, "the axis is not in operation")
        plant.until(lambda: drive.model.velocity_actual == 0, "standstill")
        plant.until(lambda: plant.state() == INHIBITED, "the gateway has it again")
        plant.stays(lambda: plant.state() == INHIBITED, "the ON that stands starts nothing")
        plant.turn()

    plant.play(sequence)
