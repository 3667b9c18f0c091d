"""Replay: equal for what this gateway recorded, a named difference for anything else."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import pytest

from pdgw.decoder.replay.replay import Replayed
from pdgw.gateway.axis.executors import speed as speed_executor
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.trace import blocks
from pdgw.gateway.trace.reader import RingReader
from pdgw.peers.drive import shape
from pdgw.recording.recordings import replayed
from pdgw.recording.trace_file import save
from tests.support.gateways.daemon import (
    OFF,
    ON,
    SIMULATED_POSITIONER,
    Plc,
    axis,
    configuration,
    drive_of,
    encoder_of,
    until,
    world_of,
)
from tests.support.gateways.recorded_daemon import recorded, recording, replay_of

ENCODER = "[[encoder]]\ndo_id = 9\nnode_id = 20\ntelegram = 83\nsimulate = true\n"
TASK = {"SATZANW": 0x8000, "MDI_TARPOS": 0x0200_0000, "MDI_VELOCITY": 1 << 29, "MDI_ACC": 0x4000, "MDI_DEC": 0x2000}


def run(plc: Plc, cycles: int) -> None:
    for _ in range(cycles):
        plc.exchange()


def speeds(plc: Plc) -> None:
    """Operation, a loss of the PLC, a fault, OFF1."""
    plc.enable()
    plc.endpoint.set(0, {"NSOLL_A" if plc.daemon.axes[0].telegram.number == 1 else "NSOLL_B": 0x1000})
    run(plc, 60)
    plc.silent = True
    run(plc, 120)
    plc.silent = False
    plc.enable()
    drive_of(plc.daemon).inject(7)
    run(plc, 60)
    drive_of(plc.daemon).clear()
    plc.endpoint.set(0, {"STW1": OFF | 0x80})
    run(plc, 20)
    plc.enable()
    plc.endpoint.set(0, {"STW1": OFF})
    run(plc, 60)


def tasks(plc: Plc) -> None:
    """Homing, a task, an intermediate stop, a rejected task."""
    plc.endpoint.set(0, {"STW1": 0x043E})
    run(plc, 150)
    plc.endpoint.set(0, {"STW1": 0x043F, "SATZANW": 0x8000 | 35})
    run(plc, 50)
    for word, more in (
        (0x0C3F, {}),
        (0x043F, {}),
        (0x047F, TASK | {"MDI_MOD": 1}),
        (0x045F, {}),
        (0x047F, {}),
        (0x046F, {}),
    ):
        plc.endpoint.set(0, {"STW1": word, **more})
        run(plc, 60)


def jogs(plc: Plc) -> None:
    """A positioner homes at its position, jogs and is switched off."""
    plc.enable()
    for word in (ON | 1 << 8, ON, ON & ~2):
        plc.endpoint.set(0, {"STW1": word})
        run(plc, 100)


def raw(plc: Plc) -> None:
    """The Controlword itself."""
    run(plc, 150)
    for word in (0, 6, 7, 15):
        plc.endpoint.set(0, {"Controlword": word, "Modes of Operation": 3, "Target Velocity": 2000})
        run(plc, 30)


def another_telegram(plc: Plc) -> None:
    """P922 while the axis is off."""
    run(plc, 150)
    plc.daemon.change_telegram(plc.daemon.axes[0], 2)
    other = Plc(plc.daemon, [2], host="plc")
    other.enable()
    other.endpoint.set(0, {"NSOLL_B": 0x1000_0000})
    run(other, 60)


def presets(plc: Plc) -> None:
    """An encoder turns and takes a preset."""
    run(plc, 150)
    plc.endpoint.set(0, {"STW2_ENC": 0x0400, "G1_STW": 0})
    run(plc, 20)
    plc.endpoint.set(0, {"G1_STW": 1 << 12})
    run(plc, 60)
    encoder_of(plc.daemon).node.restart()
    run(plc, 100)


RUNS: dict[str, tuple[str, Callable[[Plc], None]]] = {
    "telegram 1": (axis(1), speeds),
    "telegram 3": (axis(1, telegram_number=3), speeds),
    "telegram 102": (axis(1, telegram_number=102), speeds),
    "telegram 9": (axis(1, telegram_number=9), tasks),
    "telegram 100": (axis(1, telegram_number=100), raw),
    "telegram 111": (axis(1, telegram_number=111, more=SIMULATED_POSITIONER), jogs),
    "P922": (axis(1), another_telegram),
    "encoder": (ENCODER, presets),
    "encoder as G1": (axis(1, telegram_number=3, more="simulate = true\ng1 = 9") + ENCODER, speeds),
    "two axes": (axis(1) + axis(2, telegram_number=3), speeds),
}


def differences(results: list[Replayed]) -> list[object]:
    return [difference for result in results for difference in result.differences]


@pytest.mark.parametrize("name", RUNS)
def test_a_recorded_run_is_equal_to_its_end(name: str, tmp_path: Path) -> None:
    tables, happens = RUNS[name]
    with recorded(configuration(tables), tmp_path) as plc:
        happens(plc)
    results = replay_of(tmp_path)
    assert not differences(results)
    assert len(results) == tables.count("do_id")
    assert all(result.steps > 200 for result in results)


def test_a_drive_without_profile_velocity_is_replayed(tmp_path: Path) -> None:
    with recorded(configuration(axis(1, more="")), tmp_path) as plc:
        world_of(plc.daemon).drive("world", 1, shape=shape("vl"))
        until(plc.daemon, lambda: plc.daemon.axes[0].drive.generation, "online")
        plc.enable()
        plc.endpoint.set(0, {"NSOLL_A": -0x1000})
        run(plc, 100)
    assert not differences(replay_of(tmp_path))


@pytest.mark.planted
def test_a_changed_rule_is_the_difference(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with recorded(configuration(axis(1)), tmp_path) as plc:
        speeds(plc)
    monkeypatch.setattr(speed_executor, "TOLERANCE_PERCENT", 500)
    (result,) = replay_of(tmp_path)
    fields = [item.field for item in result.differences]
    assert fields
    assert all(item.recorded != item.now for item in result.differences)


def changed(folder: Path, kind: str, change: Callable[[bytearray], None]) -> list[Replayed]:
    """The replay of a recording in which one frame of a kind in operation is another one."""
    file = Path(recording(folder))
    data = bytearray(file.read_bytes())
    found = []
    for block, at, length in blocks.walk(bytes(data)):
        if block == blocks.PACKET:
            begin = at + blocks.PACKET_HEAD.size
            (identifier,) = struct.unpack_from(">I", data, begin)
            is_answer = data[begin + 42 : begin + 44] == b"\xc0\x00"
            if {"RPDO": identifier == 0x201, "TPDO": identifier == 0x181, "answer": is_answer}[kind]:
                found.append((begin, at + length - 4))
    begin, end = found[len(found) // 3]
    frame = data[begin:end]
    change(frame)
    data[begin:end] = frame
    file.write_bytes(data)
    return replayed([str(file)])


@pytest.mark.parametrize(
    ("kind", "place", "field"),
    [("RPDO", 8, "target_velocity in the RPDO"), ("TPDO", 8, "in the TPDO"), ("answer", 47, "NIST_A")],
)
def test_a_changed_frame_is_the_difference(kind: str, place: int, field: str, tmp_path: Path) -> None:
    with recorded(configuration(axis(1)), tmp_path) as plc:
        plc.enable()
        for number in range(60):
            plc.endpoint.set(0, {"NSOLL_A": 0x1000 + 16 * number})
            plc.exchange()

    def change(frame: bytearray) -> None:
        frame[place] ^= 0x15

    found = changed(tmp_path, kind, change)[0].differences
    assert field in found[0].field


def test_a_part_of_a_recording_is_refused(tmp_path: Path) -> None:
    with recorded(configuration(axis(1)), tmp_path) as plc:
        run(plc, 1200)
        with RingReader(tmp_path / "test.ring") as reader:
            newest = reader.cycles(at_most=1)[0].time_ns
            save(reader, tmp_path / "part.pcapng", newest - 1_000_000_000)
    with pytest.raises(GatewayError, match=r"begins in the middle of a run.*--record"):
        replayed([str(tmp_path / "part.pcapng")])


def test_a_capture_of_another_recorder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x.pcapng").write_bytes(blocks.section("", ("can",)))
    with pytest.raises(GatewayError, match="only a recording of the gateway itself can be replayed"):
        replayed([str(tmp_path / "x.pcapng")])
    (tmp_path / "x.log").write_text("(1.0) can0 1#00\n" * 9)
    with pytest.raises(GatewayError, match="not a recording of the gateway"):
        replayed([str(tmp_path / "x.log")])
