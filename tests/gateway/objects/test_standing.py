"""Sentences that stand: each is true an hour later, and after a restart of the gateway."""

from __future__ import annotations

from pdgw.base.durations import SECOND
from pdgw.gateway.base.reasons import Enable
from tests.support.documents.situations import BREAKERS, in_operation, run_out
from tests.support.gateways.restart import restarted

_STARTED_NS = 5 * SECOND
"""By then the next gateway knows each device, or has missed it."""


def test_heartbeat_error_after_a_killed_gateway_is_no_error_of_the_cable() -> None:
    with in_operation() as (daemon, plc):
        BREAKERS[Enable.NO_FAULT](plc, daemon)
        run_out(plc)
        with restarted(plc, daemon, killed=True) as following:
            run_out(plc, _STARTED_NS)
            assert following.axes[0].enable_status.sentence.startswith(
                "Fault: EMCY 8130h life guard or heartbeat error: the gateway sent no heartbeat before its start"
                "; before: EMCY 2310h over-current, since 22:13:20. If the gateway had not ended, check CAN cable"
            )
