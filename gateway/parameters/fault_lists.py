"""P946 and P951: the fault numbers of a drive object with their codes and texts, element n for number n.

``own`` are the manufacturer's faults by number; the gateway's are the same for every drive object.
"""

from __future__ import annotations

from collections.abc import Mapping

from pdgw.dsp402.drive_type import DriveFault
from pdgw.gateway.reasons import GATEWAY_FAULTS
from pdgw.profidrive.parameters.catalogue import NAME_SIZE

_GATEWAY_CODES = {fault.number: fault.code for fault in GATEWAY_FAULTS.values()}
_GATEWAY_NAMES = {fault.number: fault.name for fault in GATEWAY_FAULTS.values()}


def fault_codes(own: Mapping[int, DriveFault]) -> list[int]:
    """P946: the code of each fault number, 0 where there is no fault of the number."""
    codes = {fault.number: fault.error_code for fault in own.values()} | _GATEWAY_CODES
    return [codes.get(number, 0) for number in range(max(codes) + 1)]


def fault_numbers(own: Mapping[int, DriveFault]) -> list[int]:
    """P951: each fault number at its place, 0 where there is no fault of the number."""
    names = _names(own)
    return [number if number in names else 0 for number in range(max(names) + 1)]


def fault_texts(own: Mapping[int, DriveFault]) -> list[str]:
    """The texts of P951 and P947: the name of each fault number, empty where there is none."""
    names = _names(own)
    return [names.get(number, "")[:NAME_SIZE] for number in range(max(names) + 1)]


def _names(own: Mapping[int, DriveFault]) -> dict[int, str]:
    return {fault.number: fault.name for fault in own.values()} | _GATEWAY_NAMES
