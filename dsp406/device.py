"""The encoders as CANopen devices: their complete object lists, identities and the EDS made of them.

Source: CiA DSP 406 V2.0 chapters 7.1 and 7.2 (PDOs). The profile's "2nd transmit PDO" is object 1802h, the third TPDO of
CiA 301, and takes that one's pre-defined COB-ID (380h + node-ID). ``python -m dsp406.device`` rewrites ``dsp406/eds/*.eds``;
a test fails when one is out of date.
"""

from __future__ import annotations

from pathlib import Path

from pdgw.ds301.communication import communication_objects, pdo_objects
from pdgw.ds301.configuration import EVENT_DRIVEN_MANUFACTURER, EVERY_SYNC
from pdgw.ds301.eds.writer import DeviceInfo, write_eds
from pdgw.ds301.objects import ObjectSpec
from pdgw.ds301.pdo import Pdo, PdoDirection
from pdgw.dsp406.kinds import DEVICES, EncoderDevice
from pdgw.dsp406.objects import encoder_catalogue

ASYNCHRONOUS_TPDO = 1
"""1800h, driven by the cyclic timer 6200h."""
SYNCHRONOUS_TPDO = 3
"""1802h, on SYNC or remote request."""
TPDO_TYPES = {1: EVENT_DRIVEN_MANUFACTURER, 2: EVENT_DRIVEN_MANUFACTURER, 3: EVERY_SYNC, 4: EVERY_SYNC}
"""Default transmission types; 2 and 4 are there for further channels."""

VENDOR_ID = 0x0000_0406
"""A placeholder: no manufacturer makes these devices."""
REVISION = 0x0001_0000
_FOLDER = Path(__file__).parent / "eds"


def eds_path(device: EncoderDevice) -> Path:
    """Path of the EDS of one of the package's devices."""
    return _FOLDER / f"{device.name}.eds"


def device_info(device: EncoderDevice) -> DeviceInfo:
    """The [DeviceInfo] of the EDS."""
    return DeviceInfo(
        "profidrive-gateway", f"Simulated {device.name} encoder, DSP406", VENDOR_ID, device.product_code, REVISION
    )


def encoder_objects(device: EncoderDevice, serial_number: int = 1) -> tuple[ObjectSpec, ...]:
    """Every object of the encoder."""
    catalogue = encoder_catalogue(device, serial_number)
    position = catalogue.attribute("position_1")
    defaults = tuple(Pdo(PdoDirection.TPDO, number, (position,)) for number in (ASYNCHRONOUS_TPDO, SYNCHRONOUS_TPDO))
    return (
        *communication_objects(
            device.device_type,
            f"{device.name} encoder",
            (VENDOR_ID, device.product_code, REVISION, serial_number),
            ("1.0", "1.0"),
        ),
        *pdo_objects(0, device.tpdos, defaults, tpdo_types=TPDO_TYPES, event_timer=False),
        *catalogue.objects,
    )


if __name__ == "__main__":
    for item in DEVICES.values():
        eds_path(item).write_text(write_eds(device_info(item), encoder_objects(item)), encoding="ascii")
