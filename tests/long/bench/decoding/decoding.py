"""Packets per second of the decoder, scapy's dissection and ``tshark -T fields``, on the same file in one run."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.long.bench.decoding.captures import write_capture

GOAL_SCAPY = 5.0
"""Goal: the decoder's speed as a multiple of scapy's."""
GOAL_TSHARK = 1.0
_NAMES = "frame_id,cycle_counter,data_status,cob_id,stw1,nsoll_a,zsw1,nist_a,controlword,target_velocity,statusword"
_TSHARK_FIELDS = (
    "frame.time_epoch",
    "pn_rt.frame_id",
    "pn_rt.cycle_counter",
    "pn_rt.ds",
    "canopen.cob_id",
    "pn_io.io_data_object",
    "canopen.pdo.data.bytes",
)
_SCAPY = """
import sys
from scapy.config import conf
conf.debug_dissector = False
import scapy.layers.can, scapy.layers.l2, scapy.layers.inet, scapy.contrib.pnio
from scapy.utils import PcapReader
with PcapReader(sys.argv[1]) as reader:
    for packet in reader:
        packet.lastlayer()
"""


@dataclass(frozen=True, slots=True)
class DecodeSpeed:
    """Wall clock time of one reader for the whole file, including its start."""

    name: str
    packets: int
    seconds: float

    @property
    def packets_per_s(self) -> float:
        return self.packets / self.seconds


def _timed(command: Sequence[str]) -> float:
    start = time.perf_counter()
    subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=True)
    return time.perf_counter() - start


def run(packets: int, rounds: int = 3, progress: Callable[[str], None] = lambda _: None) -> list[DecodeSpeed]:
    """Measure on a file of ``packets``: decoder and tshark, if installed (best of ``rounds``), and scapy (once)."""
    with tempfile.TemporaryDirectory() as directory:
        capture = Path(directory) / "both.pcapng"
        progress(f"writing {packets} packets")
        write_capture(capture, packets)
        commands = {
            "pdgw decode --csv": [
                *(sys.executable, "-m", "pdgw", "decode", str(capture), "--telegram", "1", "--csv", _NAMES)
            ]
        }
        if shutil.which("tshark"):
            fields = [part for name in _TSHARK_FIELDS for part in ("-e", name)]
            reading = ["tshark", "-n", "-r", str(capture), "-d", "can.subdissector,canopen"]
            commands["tshark -T fields"] = [*reading, "-T", "fields", *fields]
        best = dict.fromkeys(commands, float("inf"))
        for number in range(rounds):
            for name, command in commands.items():
                progress(f"{name}, round {number + 1} of {rounds}")
                best[name] = min(best[name], _timed(command))
        progress("scapy")
        best["scapy"] = _timed([sys.executable, "-c", _SCAPY, str(capture)])
    return [DecodeSpeed(name, packets, seconds) for name, seconds in best.items()]
