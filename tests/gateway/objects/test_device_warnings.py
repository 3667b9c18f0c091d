"""Warnings that a device itself reports: the line names what they mean."""

from __future__ import annotations

import pytest

from pdgw.gateway.service.status import snapshot
from pdgw.tools.output.status_text import Health, check_line
from tests.support.documents.situations import SLOW_PLC, run_out
from tests.support.gateways.daemon import Plc, configuration, encoder_of, running

_ENCODER = "[[encoder]]\ndo_id = 2\nnode_id = 20\ntelegram = 81\nsimulate = true\n"


@pytest.mark.parametrize(
    ("cause", "text"),
    [
        ("battery", "6505h.4 = 1: its battery is nearly empty: change the battery"),
        ("light", "6505h.1 = 1: its light source is nearly worn out: plan its replacement"),
    ],
)
def test_bit_of_a_warning_of_an_encoder_is_named(cause: str, text: str) -> None:
    with running(configuration(_ENCODER, transport=SLOW_PLC)) as daemon:
        plc = Plc(daemon, [81])
        plc.endpoint.set(0, {"STW2_ENC": 0x0400})
        run_out(plc)
        encoder_of(daemon).inject(cause)
        run_out(plc)
        document = snapshot(daemon)
        assert document["encoders"][0]["warning"] == f"warning of the device: {text}"
        health, line = check_line(document)
        assert health is Health.WARNING
        assert text in line
