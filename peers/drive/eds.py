"""``python -m pdgw.peers.drive.eds`` rewrites ``dsp402/eds/engel.eds``; a test fails when the file is out of date."""

from __future__ import annotations

from pdgw.ds301.eds.writer import write_eds
from pdgw.peers.drive.device import EDS_PATH, INFO, drive_objects

if __name__ == "__main__":
    EDS_PATH.write_text(write_eds(INFO, drive_objects()), encoding="ascii")
