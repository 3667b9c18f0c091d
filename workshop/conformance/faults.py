"""The whole matrix of ``conformance faults``: every fault a simulated device can be given, against the gateway.

Source: docs/translation.md "Losses". ``run_case`` runs one case in a world of its own, in virtual time.
"""

from __future__ import annotations

from pdgw.workshop.conformance.bench import Activity, Case, Device, Reaction, Result
from pdgw.workshop.conformance.drives import DRIVE_CASES, run_drive_case
from pdgw.workshop.conformance.encoders import ENCODER_CASES, run_encoder_case, run_sensor_case

__all__ = ["CASES", "Activity", "Case", "Device", "Reaction", "Result", "run_case"]

CASES: tuple[Case, ...] = (*DRIVE_CASES, *ENCODER_CASES)
"""At least one for each fault of each kind of device (a test)."""
_RUN = {Device.DRIVE: run_drive_case, Device.ENCODER: run_encoder_case, Device.SENSOR: run_sensor_case}


def run_case(case: Case) -> Result:
    """Run one case; what does not hold is in the result, nothing is raised for it."""
    result = Result(case)
    _RUN[case.device](case, result)
    return result
