"""Required SDO writes of a drive besides its PDOs (``ds301.configuration``): the guarding.

Source: docs/translation.md "Losses".
"""

from __future__ import annotations

from pdgw.ds301.communication import CONSUMER_HEARTBEAT, PRODUCER_HEARTBEAT
from pdgw.ds301.configuration import SdoStep
from pdgw.ds301.connection_set import NODE_IDS
from pdgw.ds301.errors import CanopenError
from pdgw.ds301.objects import CanType
from pdgw.dsp402.errors import Dsp402Error
from pdgw.dsp402.indices import ABORT_OPTION, INTERPOLATION_TIME


def interpolation_steps(period_us: int) -> list[SdoStep]:
    """60C2h for a period: a count of 1 to 255 and a power of ten of a second. Dsp402Error for one that does not fit."""
    for exponent in range(-3, -7, -1):
        unit = 10 ** (6 + exponent)
        if period_us % unit == 0 and 1 <= period_us // unit <= 0xFF:
            return [
                SdoStep(INTERPOLATION_TIME, 1, CanType.U8, period_us // unit, "interpolation time"),
                SdoStep(INTERPOLATION_TIME, 2, CanType.I8, exponent, "its power of ten"),
            ]
    raise Dsp402Error("interpolation time 60C2h", f"{period_us} us", "1 to 255 times a power of ten of a microsecond")


def guard_steps(gateway_node_id: int, consumer_ms: int, producer_ms: int, abort_option: int) -> list[SdoStep]:
    """Heartbeat both ways and what the drive does when the gateway's stops; each is read back.

    Dsp402Error when a time does not fit into its object (65535 ms) or the node-ID is none.
    """
    if gateway_node_id not in NODE_IDS:
        raise Dsp402Error("gateway node-ID", gateway_node_id, "1..127")
    if not 0 <= consumer_ms <= 0xFFFF:
        raise Dsp402Error("heartbeat consumer time", f"{consumer_ms} ms", "0..65535 ms")
    try:
        return [
            SdoStep(
                CONSUMER_HEARTBEAT, 1, CanType.U32, gateway_node_id << 16 | consumer_ms, "the drive guards the gateway"
            ),
            SdoStep(ABORT_OPTION, 0, CanType.I16, abort_option, "reaction to a lost gateway"),
            SdoStep(PRODUCER_HEARTBEAT, 0, CanType.U16, producer_ms, "the drive's heartbeat"),
        ]
    except CanopenError as error:
        raise Dsp402Error(error.field, error.value, error.allowed) from error
