"""Identification of a device: its records I&M0 to I&M4 as names and texts."""

from __future__ import annotations

from pdgw.client.udp import ParameterClient
from pdgw.gateway.errors import GatewayError
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profinet.rpc.identification import INDEX, SIGNATURE, TEXT_FIELDS, Im0, decode_im, decode_im0


def read_identification(client: ParameterClient) -> dict[str, str]:
    """The fields of I&M0 and of each record that it says there is; GatewayError when one is refused or is none."""
    number = 0
    try:
        im0 = decode_im0(client.read_record(INDEX))
        found = _device(im0)
        for number in (item for item in TEXT_FIELDS if im0.supported >> item & 1):
            values = decode_im(number, client.read_record(INDEX + number))
            for (name, _), value in zip(TEXT_FIELDS[number], values, strict=True):
                found[name] = value.rstrip(b"\0").hex(" ") if number == SIGNATURE else value.decode("ascii").rstrip()
    except ProfidriveError as error:
        raise GatewayError(f"record {INDEX + number:04X}h: {error}") from error
    return found


def _device(im0: Im0) -> dict[str, str]:
    prefix, *numbers = im0.software
    return {
        "Vendor ID": f"{im0.vendor_id:04X}h",
        "Order ID": im0.order_id,
        "IM_Serial_Number": im0.serial_number,
        "IM_Hardware_Revision": str(im0.hardware_revision),
        "IM_Software_Revision": f"{prefix}{'.'.join(map(str, numbers))}",
        "IM_Revision_Counter": str(im0.revision_counter),
        "IM_Profile_ID": f"{im0.profile_id:04X}h",
        "IM_Profile_Specific_Type": f"{im0.profile_type:04X}h",
    }
