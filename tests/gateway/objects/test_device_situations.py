"""What the first line reports when the device, or its use by the PLC's program, is the cause; the remedy cures it."""

from __future__ import annotations

import pytest

from pdgw.gateway.reasons import AxisState
from pdgw.gateway.service.status import snapshot
from pdgw.tools.output.status_check import check_line
from pdgw.tools.output.status_text import cause_sentence
from tests.support.documents.device_situations import DEVICE_SITUATIONS, DeviceSituation
from tests.support.documents.situations import settle
from tests.support.gateways.daemon import Plc, configuration, running

_ATTEMPTS = 12
"""Several attempts to bring a node up, at different times within one."""


@pytest.mark.parametrize("situation", DEVICE_SITUATIONS.values(), ids=DEVICE_SITUATIONS.keys())
def test_first_line_names_the_cause_and_its_remedy_cures_it(situation: DeviceSituation) -> None:
    with running(configuration(situation.tables), situation.spoil) as daemon:
        plc = Plc(daemon, [situation.telegram])
        if not situation.is_refused:
            plc.enable()
        situation.begin(plc, daemon)
        settle(plc)
        for _ in range(_ATTEMPTS if situation.is_refused else 1):
            settle(plc)
            document = snapshot(daemon)
            line = cause_sentence(document["causes"][0])
            assert [text for text in situation.says if text.lower() not in line.lower()] == [], line
            assert [text for text in situation.lacks if text.lower() in line.lower()] == [], line
            assert line.count("is not allowed") <= 1, line
            assert check_line(document)[0] is situation.health
        situation.cure(plc, daemon)
        settle(plc)
        item = (daemon.axes or daemon.encoders)[0]
        assert item.enable_status.state is AxisState.OBEYS, item.enable_status.sentence
