"""The drive's touch probe through the whole gateway: G1 of the speed telegrams, passive homing of the positioner."""

from __future__ import annotations

import pytest

from pdgw.gateway.reasons import FaultNumber
from pdgw.profidrive.encoder import SensorError
from pdgw.profidrive.signals import signal
from tests.support.gateways.daemon import SIMULATED_POSITIONER, Plc, axis, configuration, drive_of, running

ON_THE_FLY, ACTIVATE, READ = 0x80, 0x10, 0x20
ZSW = signal("G1_ZSW")


@pytest.mark.parametrize("number", [3, 4, 102, 103])
def test_a_measurement_on_the_fly_has_the_position_at_the_edge(number: int) -> None:
    with running(configuration(axis(1, telegram_number=number))) as daemon:
        plc, drive = Plc(daemon, [number]), drive_of(daemon)
        plc.enable()
        plc.endpoint.set(0, {"NSOLL_B": 1 << 27, "G1_STW": ON_THE_FLY | ACTIVATE | 0b01})
        plc.until(lambda: plc.value("G1_ZSW") & 0b01, "active")
        plc.until(lambda: drive.model.touch_probe_status & 1, "armed")
        plc.until(lambda: drive.model.position > 2000, "it turned")
        drive.set_probe(1, True)
        where = round(drive.model.position)
        plc.until(lambda: plc.value("G1_ZSW") & ZSW.bit("VALUE_1").mask, "value available")
        plc.endpoint.set(0, {"G1_STW": ON_THE_FLY | READ | 0b01})
        plc.until(lambda: plc.value("G1_XIST2"), "read")
        assert plc.value("G1_XIST2") == where
        assert plc.value("G1_XIST1") > where, "it turned on"
        plc.endpoint.set(0, {"G1_STW": 0})
        plc.until(lambda: plc.value("G1_ZSW") == 0, "read and gone")


def test_the_falling_edge_of_probe_2_is_function_4() -> None:
    with running(configuration(axis(1, telegram_number=102))) as daemon:
        plc, drive = Plc(daemon, [102]), drive_of(daemon)
        plc.enable()
        drive.set_probe(2, True)
        plc.endpoint.set(0, {"NSOLL_B": 1 << 27, "G1_STW": ON_THE_FLY | ACTIVATE | 0b1000})
        plc.until(lambda: drive.model.touch_probe_function == 1 << 8 | 1 << 13, "armed")
        plc.until(lambda: drive.model.position > 500, "it turned")
        drive.set_probe(2, False)
        plc.until(lambda: plc.value("G1_ZSW") & ZSW.bit("VALUE_4").mask, "value available")


def test_a_reference_mark_search_finds_the_zero_pulse() -> None:
    with running(configuration(axis(1, telegram_number=3))) as daemon:
        plc = Plc(daemon, [3])
        plc.enable()
        plc.endpoint.set(0, {"NSOLL_B": -(1 << 27), "G1_STW": ACTIVATE | 0b01})
        plc.until(lambda: plc.value("G1_ZSW") & ZSW.bit("VALUE_1").mask, "mark found")
        plc.endpoint.set(0, {"G1_STW": READ | 0b01})
        plc.until(lambda: plc.value("G1_XIST2"), "read")
        assert -(1 << 32) + plc.value("G1_XIST2") == -4096


def test_a_drive_without_a_touch_probe_is_an_error_of_the_sensor() -> None:
    with running(configuration(axis(1, telegram_number=3))) as daemon:
        plc, node = Plc(daemon, [3]), drive_of(daemon).node
        plc.enable()
        for index in range(0x60B8, 0x60BE):
            node.entries.pop((index, 0))
            node.indices.discard(index)
        plc.endpoint.set(0, {"G1_STW": ON_THE_FLY | ACTIVATE | 0b01})
        plc.until(lambda: plc.value("G1_ZSW") & ZSW.bit("ERROR").mask, "error")
        assert plc.value("G1_XIST2") == 0x0F01


def test_half_an_sdo_answer_about_the_touch_probe_is_an_error_of_the_sensor_and_no_end_of_the_gateway() -> None:
    with running(configuration(axis(1, telegram_number=3))) as daemon:
        plc, node = Plc(daemon, [3]), drive_of(daemon).node
        plc.enable()
        send = node.send
        node.send = lambda can_id, data: send(can_id, data[:4] if data[:4] == b"\x4b\xb9\x60\0" else data)
        plc.endpoint.set(0, {"G1_STW": ON_THE_FLY | ACTIVATE | 0b01})
        plc.until(lambda: plc.value("G1_ZSW") & ZSW.bit("ERROR").mask, "error")
        assert plc.value("G1_XIST2") == SensorError.MEASUREMENT_ABORTED
        assert plc.state() == 0x07, "the axis goes on"


def test_passive_homing_takes_the_position_at_the_probe_while_a_task_runs() -> None:
    with running(configuration(axis(1, telegram_number=111, more=SIMULATED_POSITIONER))) as daemon:
        plc, drive = Plc(daemon, [111]), drive_of(daemon)
        plc.enable()
        homing = {"POS_STW2": signal("POS_STW2").bit("PASSIVE_HOMING").mask, "OVERRIDE": 0x4000}
        plc.endpoint.set(0, homing | {"STW1": 0x0C3F, "MDI_ACC": 0x4000, "MDI_DEC": 0x4000})
        plc.until(lambda: drive.model.touch_probe_function == 0x11, "armed")
        assert plc.value("POS_ZSW1") & signal("POS_ZSW1").bit("PASSIVE_HOMING").mask
        plc.endpoint.set(0, {"POS_STW1": 0x8100, "MDI_TARPOS": 40_000, "MDI_VELOCITY": 3000, "STW1": 0x0C7F})
        plc.until(lambda: drive.model.position > 2048, "under way")
        drive.set_probe(1, True)
        where = drive.model.position
        home = signal("ZSW1").bit("HOME_POSITION_SET", positioning=True).mask
        plc.until(lambda: plc.value("ZSW1") & home, "homed")
        reached = signal("ZSW1").bit("TARGET_REACHED").mask
        plc.until(lambda: plc.value("ZSW1") & reached, "the task goes on to its end")
        expected = 40_000 - where * 10_000 / 4096
        assert abs(plc.value("XIST_A") - expected) <= 3, "the edge is the reference coordinate 0"
        assert drive.model.touch_probe_function == 0


def test_passive_homing_without_a_touch_probe_is_a_warning() -> None:
    with running(configuration(axis(1, telegram_number=111, more=SIMULATED_POSITIONER))) as daemon:
        plc, node = Plc(daemon, [111]), drive_of(daemon).node
        plc.enable()
        node.entries.pop((0x60B8, 0))
        node.indices.discard(0x60B8)
        plc.endpoint.set(0, {"POS_STW2": signal("POS_STW2").bit("PASSIVE_HOMING").mask, "STW1": 0x0C3F})
        plc.until(lambda: plc.value("WARN_CODE") == FaultNumber.POSITIONER, "warning")
