"""The whole matrix of ``pdgw conformance faults``: every fault a simulated device can be given, against the gateway.

Source: docs/translation.md "Loss and doubt". ``run_case`` runs one case with a device of its own on a virtual bus, in real time.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor

from pdgw.tools.conformance.bench import Activity, Case, Device, Reaction, Result
from pdgw.tools.conformance.drives import DRIVE_CASES, run_drive_case
from pdgw.tools.conformance.encoders import ENCODER_CASES, run_encoder_case, run_sensor_case

__all__ = ["CASES", "JOBS", "Activity", "Case", "Device", "Reaction", "Result", "run_case", "run_cases"]

CASES: tuple[Case, ...] = (*DRIVE_CASES, *ENCODER_CASES)
"""At least one for each fault of each kind of device (a test)."""
JOBS = 8
"""So many devices at a time: most of each case is waiting."""
_ATTEMPTS = 3
_RUN = {Device.DRIVE: run_drive_case, Device.ENCODER: run_encoder_case, Device.SENSOR: run_sensor_case}


def run_case(case: Case) -> Result:
    """Run one case; what does not hold is in the result, nothing is raised for it.

    A failure on a machine too busy for its cycles, or of a device lost although its fault does not silence it, is tried again.
    """
    for _ in range(_ATTEMPTS):
        result = Result(case)
        _RUN[case.device](case, result)
        if result.passed or not result.starved:
            break
    return result


def run_cases(cases: Iterable[Case] = CASES, jobs: int = JOBS) -> Iterator[Result]:
    """The results in the order of the cases, ``jobs`` of them at a time."""
    with ThreadPoolExecutor(jobs) as pool:
        yield from pool.map(run_case, cases)
