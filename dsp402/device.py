"""The drive as a CANopen device: its complete object list, identity and the EDS made of them.

``python -m dsp402.device`` rewrites ``dsp402/eds/engel.eds``; a test fails when the file is out of date.
"""

from __future__ import annotations

from pathlib import Path

from pdgw.ds301.communication import communication_objects, pdo_objects
from pdgw.ds301.eds import DeviceInfo, write_eds
from pdgw.ds301.objects import ObjectSpec
from pdgw.ds301.pdo import PdoDirection
from pdgw.dsp402.objects import DRIVE_OBJECTS
from pdgw.dsp402.pdo import pdo

EDS_PATH = Path(__file__).parent / "eds" / "engel.eds"

DEVICE_TYPE = 0x0002_0192
"""Profile 402, servo drive."""
VENDOR_ID = 0x0000_0400
"""A placeholder: the manufacturer's vendor-ID is not in the public material (unverified)."""
PRODUCT_CODE = 0x0000_0001
REVISION = 0x0003_004A
DEFAULT_PDOS = (
    pdo(PdoDirection.RPDO, 1, "controlword", "target_velocity"),
    pdo(PdoDirection.TPDO, 1, "statusword", "velocity_actual"),
)
"""The mappings after power-on."""
INFO = DeviceInfo("ENGEL Elektroantriebe GmbH", "Servo drive, DSP402", VENDOR_ID, PRODUCT_CODE, REVISION)


def drive_objects(serial_number: int = 1, pdos: int = 5) -> tuple[ObjectSpec, ...]:
    """Every object of the drive; ``pdos`` is the number of RPDOs and of TPDOs it has."""
    return (
        *communication_objects(
            DEVICE_TYPE, "ENGEL HBI", (VENDOR_ID, PRODUCT_CODE, REVISION, serial_number), ("1.0", "3.74")
        ),
        *pdo_objects(pdos, pdos, DEFAULT_PDOS),
        *DRIVE_OBJECTS.objects,
    )


if __name__ == "__main__":
    EDS_PATH.write_text(write_eds(INFO, drive_objects()), encoding="ascii")
