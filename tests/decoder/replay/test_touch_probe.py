"""Replay of what a drive's touch probe latched: measurements of G1, passive homing of the positioner."""

from __future__ import annotations

from pathlib import Path

import pytest

from pdgw.profidrive.signals import signal
from tests.support.gateways.daemon import SIMULATED_POSITIONER, axis, drive_of
from tests.support.gateways.recorded_daemon import RecordedPlc, only, recorded

ON_THE_FLY, ACTIVATE, READ = 0x80, 0x10, 0x20
VALUE_1 = signal("G1_ZSW").bit("VALUE_1").mask
POSITION_READ = b"\x43\xba\x60\x00"


def measure(plc: RecordedPlc) -> None:
    drive = drive_of(plc.daemon)
    plc.enable()
    plc.endpoint.set(0, {"NSOLL_B": 1 << 27, "G1_STW": ON_THE_FLY | ACTIVATE | 1})
    plc.until(lambda: drive.model.touch_probe_status & 1, "armed")
    plc.until(lambda: drive.model.position > 500, "it turned")
    drive.set_probe(1, True)
    plc.until(lambda: plc.value("G1_ZSW") & VALUE_1, "value available")
    plc.endpoint.set(0, {"G1_STW": ON_THE_FLY | READ | 1})
    plc.until(lambda: plc.value("G1_XIST2"), "read")
    plc.endpoint.set(0, {"G1_STW": 0, "NSOLL_B": 0})
    for _ in range(30):
        plc.exchange()


@pytest.mark.parametrize("number", [3, 102])
def test_a_measurement_on_the_fly_is_replayed(number: int, tmp_path: Path) -> None:
    with recorded([number], axis(1, telegram_number=number)) as plc:
        measure(plc)
        assert only(plc.replayed(tmp_path)) == []


def test_another_latched_position_is_another_measured_value(tmp_path: Path) -> None:
    with recorded([3], axis(1, telegram_number=3)) as plc:
        measure(plc)
        can = plc.frames.can
        (place,) = (i for i, item in enumerate(can) if item[2].startswith(POSITION_READ))
        now, cob_id, data = can[place]
        can[place] = (now, cob_id, data[:4] + (1234).to_bytes(4, "little"))
        assert only(plc.replayed(tmp_path)) == [("actual values", ("G1_XIST2",))]


def test_search_rejected_by_the_drive_is_replayed_as_the_same_error(tmp_path: Path) -> None:
    with recorded([3], axis(1, telegram_number=3)) as plc:
        plc.enable()
        node = drive_of(plc.daemon).node
        for index in range(0x60B8, 0x60BE):
            node.entries.pop((index, 0))
            node.indices.discard(index)
        plc.endpoint.set(0, {"G1_STW": ON_THE_FLY | ACTIVATE | 0b01})
        plc.until(lambda: plc.value("G1_XIST2") == 0x0F01, "error")
        for _ in range(50):
            plc.exchange()
        assert only(plc.replayed(tmp_path)) == []


def test_passive_homing_is_replayed(tmp_path: Path) -> None:
    with recorded([111], axis(1, telegram_number=111, more=SIMULATED_POSITIONER)) as plc:
        drive = drive_of(plc.daemon)
        plc.enable()
        homing = {"POS_STW2": signal("POS_STW2").bit("PASSIVE_HOMING").mask, "OVERRIDE": 0x4000}
        plc.endpoint.set(0, homing | {"STW1": 0x0C3F, "MDI_ACC": 0x4000, "MDI_DEC": 0x4000})
        plc.until(lambda: drive.model.touch_probe_function == 0x11, "armed")
        plc.endpoint.set(0, {"POS_STW1": 0x8100, "MDI_TARPOS": 20_000, "MDI_VELOCITY": 6000, "STW1": 0x0C7F})
        plc.until(lambda: drive.model.position > 1024, "under way")
        drive.set_probe(1, True)
        home = signal("ZSW1").bit("HOME_POSITION_SET", positioning=True).mask
        plc.until(lambda: plc.value("ZSW1") & home, "homed")
        for _ in range(30):
            plc.exchange()
        assert only(plc.replayed(tmp_path)) == []


def test_the_numbers_of_the_fault_buffer_are_not_compared(tmp_path: Path) -> None:
    with recorded([111], axis(1, telegram_number=111, more=SIMULATED_POSITIONER)) as plc:
        plc.enable()
        drive_of(plc.daemon).model.inject(7)
        plc.until(lambda: plc.value("FAULT_CODE"), "in fault")
        for _ in range(60):
            plc.exchange()
        assert only(plc.replayed(tmp_path)) == []


@pytest.mark.parametrize(("key", "telegram_number"), [("g1", 3), ("g2", 4)])
def test_the_words_of_an_encoder_on_another_node_are_not_compared(
    key: str, telegram_number: int, tmp_path: Path
) -> None:
    encoder = '[[encoder]]\ndo_id = 2\nnode_id = 20\ntelegram = 81\nsimulate = true\nmotion = "still=0.75"\n'
    tables = axis(1, telegram_number=telegram_number, more=f"simulate = true\n{key} = 2") + encoder
    with recorded([telegram_number, 81], tables) as plc:
        plc.enable()
        sensor = key.upper()
        plc.endpoint.set(0, {f"{sensor}_STW": 1 << 13, "NSOLL_B": 1 << 27})
        plc.until(lambda: plc.value(f"{sensor}_XIST2") == 3072, "the encoder's position")
        for _ in range(60):
            plc.exchange()
        assert only(plc.replayed(tmp_path)) == []
