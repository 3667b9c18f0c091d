"""``pdgw trace``: the flight recorder as a capture other programs read, and what keeps parts of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from pdgw.base.durations import SECOND
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.configuration.defaults import Trigger
from pdgw.gateway.configuration.file import parse_config
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.trace.reader import RingReader
from pdgw.gateway.trace.recorder import FlightRecorder
from pdgw.tools.commands.capture.timeline import timeline
from pdgw.tools.decoder.capture.pcap import configuration_in
from pdgw.tools.decoder.capture.source import open_source
from pdgw.tools.decoder.frames.engine import Packet
from pdgw.tools.decoder.frames.records import LinkType
from pdgw.tools.recording.trace_keeper import Choice, Keeper, chosen_ring, follow, save
from tests.support.gateways import profinet_daemon
from tests.support.gateways.daemon import OFF, ON, Plc, axis, configuration, drive_of, world_of
from tests.support.gateways.daemon import running as playing
from tests.support.gateways.recorded_daemon import recorded as recorded_gateway
from tests.support.readers import tshark
from tests.support.wire.profinet import DEVICE_MAC, PLC_MAC


@contextmanager
def recorded(directory: Path, text: str = "") -> Iterator[tuple[Daemon, Plc, RingReader]]:
    """A daemon with one axis in operation, and its ring."""
    recorders: list[FlightRecorder] = []

    def before(daemon: Daemon) -> None:
        recorders.append(FlightRecorder(daemon, directory, "test"))
        daemon.services.append(recorders[0])

    with playing(configuration(text or axis(1)), before) as daemon:
        plc = Plc(daemon, [1])
        plc.enable()
        path = recorders[0].path
        assert path is not None
        reader = RingReader(path)
        yield daemon, plc, reader


def pass_time(plc: Plc, nanoseconds: int) -> None:
    until = plc.loop.now() + nanoseconds
    plc.until(lambda: plc.loop.now() >= until, "time passes")


def test_saved_trace_has_both_buses_and_the_configuration(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with recorded(tmp_path) as (_, plc, reader):
        pass_time(plc, SECOND)
        file = tmp_path / "x.pcapng"
        count = save(reader, file)
    with open_source(str(file)) as source:
        packets = [packet for packet in source.packets if isinstance(packet, Packet)]
    assert count == len(packets) > 1000
    assert parse_config(configuration_in(file)).axis[0].telegram == 1
    timeline([str(file)])
    out = capsys.readouterr().out
    assert "+OPERATION_ENABLED" in out
    assert "clocks: one clock" in out


@pytest.mark.tshark
@tshark.needs_tshark
def test_tshark_reads_a_saved_trace_of_both_link_types_without_a_malformed_packet(tmp_path: Path) -> None:
    with recorded(tmp_path) as (daemon, plc, reader):
        pass_time(plc, SECOND // 2)
        file = tmp_path / "x.pcapng"
        count = save(reader, file)
        assert save(reader, compressed := tmp_path / "x.pcapng.gz") == count
        wall = world_of(daemon).loop.wall()
    rows = tshark.fields(
        file,
        ["frame.encap_type", "frame.interface_name", "frame.time_epoch", "pn_rt.frame_id", "can.id", "_ws.malformed"],
    )
    assert compressed.stat().st_size < file.stat().st_size / 4
    assert len(tshark.fields(compressed, ["frame.time_epoch"])) == len(rows)
    rows = [row for row in rows if row["frame.time_epoch"]]  # the steps are blocks without a time
    assert len(rows) == count
    assert {row["frame.interface_name"] for row in rows} == {"plc", "can"}
    assert len({row["frame.encap_type"] for row in rows}) == 2
    assert not [row for row in rows if row["_ws.malformed"]]
    times = [float(row["frame.time_epoch"]) for row in rows]
    assert all(later > before - 0.001 for before, later in pairwise(times)), "the order of processing"
    assert times[-1] == pytest.approx(wall, abs=1)
    plc_frames = [row for row in rows if row["frame.interface_name"] == "plc"]
    assert {int(row["pn_rt.frame_id"], 0) for row in plc_frames} == {0xC000, 0xC001}
    assert {"0x00000201", "0x00000181"} <= {f"0x{int(row['can.id'], 0):08x}" for row in rows if row["can.id"]}


def test_only_the_last_seconds_are_saved_on_request(tmp_path: Path) -> None:
    with recorded(tmp_path) as (_, plc, reader):
        pass_time(plc, 10 * SECOND)
        newest = reader.cycles(at_most=1)[0].time_ns
        whole = save(reader, tmp_path / "a.pcapng")
        part = save(reader, tmp_path / "b.pcapng", newest - SECOND // 10)
        assert 0 < part < whole / 5
        saved = RingReader(tmp_path / "b.pcapng")
        first, *_, last = saved.cycles()
        assert newest - 12 * SECOND // 10 < first.time_ns <= newest - SECOND // 10
        assert last.time_ns == newest
        assert last.steps == reader.cycles(at_most=1)[0].steps
        with pytest.raises(GatewayError, match="cannot be written"):
            save(reader, tmp_path / "missing" / "c.pcapng")


def test_ring_of_the_running_gateway_is_the_default(tmp_path: Path) -> None:
    with pytest.raises(GatewayError, match=r"no ring file of a gateway.*none"):
        chosen_ring(None, tmp_path)
    with recorded_gateway(configuration(axis(1)), tmp_path) as second:
        with recorded(tmp_path) as (_, _, reader):
            assert reader.path.name == "test-2.ring"
            with pytest.raises(GatewayError, match=r"(test-2, test|test, test-2)$"):
                chosen_ring(None, tmp_path)
        assert second.daemon.recorder is not None
        assert chosen_ring(None, tmp_path) == second.daemon.recorder.path
        assert chosen_ring("test-2", tmp_path) == reader.path
        assert chosen_ring(str(reader.path)) == reader.path
    with pytest.raises(GatewayError, match="--ring other"):
        chosen_ring("other", tmp_path)


# -- keeping ---------------------------------------------------------------------------------------------------------------


def choice(directory: Path, *triggers: Trigger, files: int = 20) -> Choice:
    return Choice(directory / "kept", frozenset(triggers or Trigger), before_s=1, after_s=1, files=files)


def happen(daemon: Daemon, plc: Plc, keeper: Keeper) -> None:
    """A fault, and time enough for what comes after it."""
    daemon.axes[0].raise_fault(FaultNumber(127), "made up", plc.loop.now())
    pass_time(plc, 2 * SECOND)
    keeper.poll()


def test_a_fault_keeps_the_seconds_before_and_after_it(tmp_path: Path) -> None:
    with recorded(tmp_path) as (daemon, plc, reader):
        keeper = Keeper(reader, choice(tmp_path, Trigger.FAULT))
        pass_time(plc, 3 * SECOND)
        keeper.poll()
        assert keeper.kept == []
        drive_of(daemon).inject(7)
        pass_time(plc, SECOND // 2)
        keeper.poll()
        assert keeper.kept == []  # what comes after belongs to it
        pass_time(plc, SECOND)
        keeper.poll()
        (file,) = keeper.kept
        assert file.name.startswith("test-2023")
        assert file.name.endswith("-fault-axis-1.pcapng")
        pass_time(plc, 2 * SECOND)
        keeper.poll()
        assert len(keeper.kept) == 1  # one fault, one file
    assert configuration_in(file)


@pytest.mark.parametrize(
    ("happens", "kept"),
    [
        (lambda plc: setattr(plc, "silent", True), True),
        (lambda plc: plc.endpoint.set(0, {"STW1": ON & ~0x400}), True),
        (lambda plc: drive_of(plc.daemon).inject(7), True),
        (lambda plc: plc.endpoint.set(0, {"STW1": OFF}), False),
        (lambda plc: plc.endpoint.set(0, {"STW1": ON & ~2}), False),
        (lambda plc: plc.endpoint.set(0, {"STW1": ON & ~0x40}), False),
    ],
    ids=["PLC lost", "control lost", "fault", "OFF1", "OFF2", "setpoint disabled"],
)
def test_only_stops_without_a_plc_command_are_kept(
    tmp_path: Path, happens: Callable[[Plc], object], kept: bool
) -> None:
    with recorded(tmp_path) as (_, plc, reader):
        keeper = Keeper(reader, choice(tmp_path, Trigger.STOP))
        pass_time(plc, SECOND // 10)
        happens(plc)
        plc.loop.run_for(SECOND // 100)
        pass_time(plc, 2 * SECOND)
        keeper.poll()
        assert [file.name.endswith("-stop-axis-1.pcapng") for file in keeper.kept] == ([True] if kept else [])


def test_a_gateway_killed_right_after_a_stop_has_a_file_of_each(tmp_path: Path) -> None:
    with recorded(tmp_path) as (_, plc, reader):
        keeper = Keeper(reader, choice(tmp_path, Trigger.STOP))
        pass_time(plc, SECOND // 10)
        plc.silent = True
        plc.loop.run_for(SECOND // 2)
        keeper.poll()
        assert keeper.kept == []  # what comes after the stop belongs to it
        keeper.ended()
        assert [file.stem.split("-", 3)[-1] for file in keeper.kept] == ["stop-axis-1", "killed"]


def test_oldest_files_are_deleted(tmp_path: Path) -> None:
    with recorded(tmp_path) as (daemon, plc, reader):
        keeper = Keeper(reader, choice(tmp_path, Trigger.FAULT, files=2))
        pass_time(plc, SECOND // 10)
        keeper.poll()
        for _ in range(4):
            happen(daemon, plc, keeper)
        assert len(keeper.kept) == 4
        assert sorted((tmp_path / "kept").iterdir()) == sorted(keeper.kept[2:])


def test_failed_file_is_removed_and_keeping_continues(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    with recorded(tmp_path) as (daemon, plc, reader):
        keeper = Keeper(reader, choice(tmp_path, Trigger.FAULT))
        pass_time(plc, SECOND // 10)
        keeper.poll()
        for error in (OSError("no space left"), KeyError("a mistake")):

            def unwritable(*arguments: Any, error: Exception = error) -> None:
                arguments[1].write_bytes(b"half of it")
                raise error

            monkeypatch.setattr("pdgw.tools.recording.trace_keeper.save", unwritable)
            happen(daemon, plc, keeper)
            assert keeper.kept == []
            assert list((tmp_path / "kept").iterdir()) == []
        assert "not kept (no space left)" in caplog.text
        monkeypatch.setattr("pdgw.tools.recording.trace_keeper.save", save)
        happen(daemon, plc, keeper)
        assert len(keeper.kept) == 1


def test_a_keeper_follows_the_gateway_that_replaces_another(tmp_path: Path) -> None:
    steps = iter(range(100))
    gateways = ExitStack()
    daemons: list[tuple[Daemon, Plc]] = []

    def begin() -> None:
        daemon, plc, _ = gateways.enter_context(recorded(tmp_path))
        daemons.append((daemon, plc))

    def fault() -> None:
        daemon, plc = daemons[-1]
        pass_time(plc, SECOND)
        daemon.axes[0].raise_fault(FaultNumber(127), "made up", plc.loop.now())
        pass_time(plc, 3 * SECOND)

    actions = {1: fault, 3: gateways.close, 5: begin, 7: fault, 9: gateways.close}

    def wait(_: float) -> bool:
        step = next(steps)
        actions.get(step, lambda: None)()
        return step > 12

    begin()
    follow(tmp_path / "test.ring", choice(tmp_path, Trigger.FAULT), wait)
    assert len(daemons) == 2
    assert len(list((tmp_path / "kept").iterdir())) == 1  # the same second and the same axis: one name


def test_a_profinet_gateways_trace_has_its_ethernet_frames(tmp_path: Path) -> None:
    config = profinet_daemon.configuration(axis(1), tmp_path / "store.json")
    with profinet_daemon.plant(config) as plant:
        recorder = FlightRecorder(plant.daemon, tmp_path, "test")
        plant.daemon.services.append(recorder)
        plant.run(SECOND // 10)
        plant.connect()
        plant.enable(1, 0x2000)
        plant.run(SECOND // 2)
        assert recorder.path is not None
        reader = RingReader(recorder.path)
        cycle = reader.cycles(at_most=1)[0]
        assert list(reader.setpoints(cycle, 0) or ()) == [ON, 0x2000]
        assert (reader.actuals(cycle, 0) or (0,))[0] == plant.word()
        save(reader, tmp_path / "x.pcapng")
    with open_source(str(tmp_path / "x.pcapng")) as source:
        found = {
            packet.data for packet in source.packets if isinstance(packet, Packet) and packet.link == LinkType.ETHERNET
        }
    sent = {frame[18:] for _, frame in plant.frames if frame[:6] == DEVICE_MAC}
    # What the controller sent is there to the byte, but for the tag in front, which the kernel takes off.
    assert {data[:6] for data in found} >= {DEVICE_MAC, PLC_MAC}
    assert len([data for data in found if data[:6] == DEVICE_MAC and data[14:] in sent]) > 50
    cyclic = [data for data in found if data[:6] == DEVICE_MAC and data[12:14] == b"\x88\x92" and data[14] < 0xFC]
    assert all(data[14:] in sent for data in cyclic)
