"""Properties of every telegram of a drive: no setpoints start it without OFF and ON, OFF stops it, ON starts it again.

Hypothesis chooses the values of all signals; ``make conformance`` tries more of them.
"""

from __future__ import annotations

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from pdgw.dsp402.states import State
from pdgw.gateway.axis.supervision.drive_events import POWERED
from pdgw.gateway.configuration.file import simulated
from pdgw.profidrive.telegrams import TELEGRAMS, ApplicationMode, telegram
from tests.conformance.rig import COMPLETE, DriveRig
from tests.support.axis.strategies import half_values
from tests.support.gateways.daemon import drive_of, running

NUMBERS = [number for number, item in TELEGRAMS.items() if item.mode is not ApplicationMode.ENCODER]
EXAMPLES = settings(max_examples=100 if COMPLETE else 2, phases=[Phase.generate])
"""Not shrunk: that takes minutes."""
_ON = 0x0001


def frames(number: int) -> st.SearchStrategy[list[tuple[dict[str, int], int]]]:
    """Setpoints of a telegram, each with its number of cycles. Half of the control words leave the axis enabled."""
    half = telegram(number).setpoints
    enabled = 0x0F if number == 100 else 0x047F
    words = st.just(enabled) | st.integers(0, 0xFFFF)
    values = st.tuples(half_values(half), words).map(lambda drawn: half.as_dict((drawn[1], *drawn[0][1:])))
    return st.lists(st.tuples(values, st.integers(1, 50)), min_size=1, max_size=5)


@pytest.mark.parametrize("number", [number for number in NUMBERS if number != 100])
@EXAMPLES
@given(data=st.data())
def test_no_setpoints_start_a_drive_without_off(number: int, data: st.DataObject) -> None:
    with running(simulated([number])) as daemon:
        rig = DriveRig(daemon, drive_of(daemon))
        for values, cycles in data.draw(frames(number)):
            rig.plc.set(0, values | {rig.word: values[rig.word] | _ON})
            rig.cycles(cycles)
        rig.online()
        rig.settle()
        assert not [state for state, _ in rig.states if state in POWERED]


@pytest.mark.parametrize("number", NUMBERS)
@EXAMPLES
@given(data=st.data())
def test_off_stops_and_on_starts_a_drive_after_any_setpoints(number: int, data: st.DataObject) -> None:
    with running(simulated([number])) as daemon:
        rig = DriveRig(daemon, drive_of(daemon))
        rig.enable()
        for values, cycles in data.draw(frames(number)):
            rig.plc.set(0, values)
            rig.cycles(cycles)
        rig.plc.set(0, dict.fromkeys(rig.plc.endpoint.setpoints[0], 0))
        rig.off()
        rig.until(lambda: rig.standing() and rig.model.state not in POWERED, "OFF obeyed")
        rig.enable()
        rig.settle()
        assert rig.standing()
        assert rig.model.state is State.OPERATION_ENABLED
