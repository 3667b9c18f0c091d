"""What an axis does for a long time is in its line from the first second on."""

from __future__ import annotations

from pdgw.base.durations import MS, SECOND
from pdgw.gateway.service.status import snapshot
from pdgw.tools.output.status_text import Health, check_line, object_lines, status_lines
from tests.support.documents.device_situations import MDI, POSITIONER
from tests.support.documents.situations import in_operation, run_out, words


def test_a_homing_that_does_not_end_is_named_with_its_begin() -> None:
    with in_operation(POSITIONER.replace("homing_method = 35", "homing_method = 17")) as (daemon, plc):
        words((0x043E, MDI), (0x043F, {}))(plc, daemon)
        assert snapshot(daemon)["axes"][0]["activity"] == ""
        plc.endpoint.set(0, {"STW1": 0x0C3F})
        run_out(plc, 500 * MS)
        first = snapshot(daemon)["axes"][0]["activity"]
        assert first.startswith("homing since 22:13:")
        run_out(plc, 5 * SECOND)
        document = snapshot(daemon)
        assert document["axes"][0]["activity"] == first, "still the same homing"
        assert any(f"telegram 111, {first}" in line for line in status_lines(document, 400))
        assert any(f"note: {first}" in line for line in object_lines(document, 1, 400))
        assert check_line(document)[0] is Health.OK


def test_a_home_position_that_was_lost_and_found_again_is_not_named() -> None:
    with in_operation(POSITIONER) as (daemon, plc):
        executor = daemon.axes[0].machine.executor
        words((0x043E, MDI), (0x043F, {}))(plc, daemon)
        assert executor.home_lost == 0, "there was none"
        plc.endpoint.set(0, {"STW1": 0x0C3F})
        plc.until(lambda: plc.value("ZSW1") & 1 << 11, "the home position")
        executor.lost()
        assert executor.home_lost
        words((0x043F, {}), (0x0C3F, {}))(plc, daemon)
        plc.until(lambda: plc.value("ZSW1") & 1 << 11, "the home position again")
        assert executor.home_lost == 0
