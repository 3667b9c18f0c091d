"""The decoder against tshark and scapy on the same capture of both buses, and the timeline against real time."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from tests.support.readers.both_buses import write_capture

TITLES = ("program", "CPU", "packets/s", "of recorded time", "pdgw decode is")
PACKETS = 200_000
_PACKETS_PER_S = 4000
_FIELDS = "frame_id,cycle_counter,data_status,cob_id,stw1,nsoll_a,zsw1,nist_a,controlword,target_velocity,statusword"
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


def commands(capture: str) -> Iterator[tuple[str, Sequence[str]]]:
    """Each program with its arguments."""
    pdgw = [sys.executable, "-m", "pdgw"]
    yield "pdgw decode --csv", [*pdgw, "decode", capture, "--telegram", "1", "--csv", _FIELDS]
    yield "pdgw timeline", [*pdgw, "timeline", capture, "--telegram", "1"]
    if shutil.which("tshark"):
        fields = [part for name in _TSHARK_FIELDS for part in ("-e", name)]
        reading = ["tshark", "-n", "-r", capture, "-d", "can.subdissector,canopen"]
        yield "tshark -T fields", [*reading, "-T", "fields", *fields]
    yield "scapy", [sys.executable, "-c", _SCAPY, capture]


def rows(packets: int) -> Iterator[tuple[str, ...]]:
    """The lines of the table, start-up included."""
    with tempfile.TemporaryDirectory() as folder:
        capture = Path(folder) / "both.pcapng"
        write_capture(capture, packets)
        decode_s = 0.0
        for name, command in commands(str(capture)):
            begin = time.perf_counter()
            subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=True)
            seconds = time.perf_counter() - begin
            decode_s = decode_s or seconds
            rates = f"{packets / seconds:.0f}", f"{packets / _PACKETS_PER_S / seconds:.1f} x"
            yield (name, f"{seconds:.2f} s", *rates, f"{seconds / decode_s:.1f} x as fast")
