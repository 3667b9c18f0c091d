"""The complete matrix of ``conformance faults``: every fault of a simulated device on the gateway.

Source: docs/translation.md "Losses". ``run_case`` runs one case in a world of its own, in virtual time.
"""

from __future__ import annotations

from tests.long.conformance.bench import Activity, Case, Device, Reaction, Result
from tests.long.conformance.drives import DRIVE_CASES, run_drive_case
from tests.long.conformance.encoders import ENCODER_CASES, run_encoder_case, run_sensor_case

__all__ = ["CASES", "Activity", "Case", "Device", "Reaction", "Result", "run_case"]

CASES: tuple[Case, ...] = (*DRIVE_CASES, *ENCODER_CASES)
"""At least one case for each fault of each type of device (checked by a test)."""
_RUN = {Device.DRIVE: run_drive_case, Device.ENCODER: run_encoder_case, Device.SENSOR: run_sensor_case}


def run_case(case: Case) -> Result:
    """Run one case. Failures are in the result; none is raised."""
    result = Result(case)
    _RUN[case.device](case, result)
    return result
