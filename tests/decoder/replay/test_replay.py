"""Replay: equal for what this gateway recorded, also of scenarios and over PROFINET, a named difference for anything else."""

from __future__ import annotations

import lzma
import struct
from collections.abc import Callable
from pathlib import Path

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.gateway.axis.executors import speed as speed_executor
from pdgw.gateway.axis.machine import AxisMachine
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.configuration.file import simulated
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.trace import pcapng
from pdgw.gateway.trace.pcapng import Description
from pdgw.gateway.trace.reader import Cycle, Frame, Parser, RingReader
from pdgw.gateway.trace.step_reader import Step
from pdgw.gateway.trace.steps import EVENTS
from pdgw.peers.drive import shape
from pdgw.peers.plc.engine import Engine
from pdgw.peers.plc.scenario_file import load_scenario
from pdgw.profidrive.frame import STATUS_RUN
from pdgw.tools.decoder import step_replay
from pdgw.tools.decoder.step_replay import Replayed, replay
from pdgw.tools.decoder.timeline.text import entry_lines
from pdgw.tools.recording.recordings import replayed
from pdgw.tools.recording.trace_keeper import save
from tests.decoder.replay.runs import RUNS, kept, speeds
from tests.long.soak.planted import DEFECTS
from tests.support.gateways import profinet_daemon
from tests.support.gateways.daemon import OFF, axis, configuration, until, world_of
from tests.support.gateways.recorded_daemon import differences, record, recorded, recording, replay_of
from tests.support.gateways.seen_steps import SeenSteps
from tests.support.readers.timeline import own_timeline
from tests.tour.console import File, steps
from tests.tour.tour import DOCUMENTS, ROOT


def kept_replay(name: str, folder: Path) -> list[Replayed]:
    """The replay of a kept recording."""
    file = folder / "gateway.pcapng"
    file.write_bytes(lzma.decompress(kept(name).read_bytes()))
    return replayed([str(file)])


@pytest.mark.parametrize("name", RUNS)
def test_a_kept_recording_is_equal(name: str, tmp_path: Path) -> None:
    """See ``runs``: what this version decides otherwise needs a line in the changelog, and new recordings."""
    results = kept_replay(name, tmp_path)
    assert not differences(results)
    assert all(result.steps > 200 for result in results)


@pytest.mark.parametrize("name", RUNS)
def test_no_step_depends_on_the_report_before(name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The axis has one record for all of its reports."""
    begin = step_replay._Object._give

    def give(each: step_replay._Object, step: Step) -> None:
        begin(each, step)
        if isinstance(each._machine, AxisMachine):
            report = each._machine.executor.report
            report.fill_motion(Reason.NO_CONTROL, -1, 77, 78, 79, 80, (81, 82))
            report.raw = (83,) * 12

    monkeypatch.setattr(step_replay._Object, "_give", give)
    assert not differences(kept_replay(name, tmp_path))


FOUND = {
    "a lost PLC does not stop the drive": "telegram 1",
    "an EMCY is not in the fault buffer": "telegram 1",
    "the drive gets twice the speed": "telegram 1",
    "ZSW1.10 is always 1": "telegram 1",
    "an ON without an OFF before it starts the drive": "telegram 1",
    "OFF2 does not lock": "telegram 1",
    "OFF3 does not lock": "telegram 1",
    "a fault of the drive does not lock": "telegram 1",
    "Quick Stop is sent as Shutdown": "telegram 1",
    "a Statusword older than the command counts as new": "silent drive",
    "a silent drive counts as online": "silent drive",
}
"""The planted defects of the axis machine, each with a recording that finds it."""
BEFORE_THE_MACHINE = {
    "setpoints stay in force after a loss of the PLC",
    "a lost drive is not brought up again",
    "the drive follows a PLC in STOP",
    "the drive follows setpoints with IOPS BAD",
    "a TPDO that shows every motion counts as not sent",
}
"""Defects of the link, the node and its TPDOs: a replay gives the machine their recorded results, and does not run them."""


def test_each_planted_defect_is_found_or_outside_the_machine() -> None:
    assert FOUND.keys() | BEFORE_THE_MACHINE == DEFECTS.keys()


@pytest.mark.planted
@pytest.mark.parametrize("name", FOUND)
def test_a_planted_defect_is_a_difference_of_a_kept_recording(
    name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    DEFECTS[name](monkeypatch)
    assert differences(kept_replay(FOUND[name], tmp_path))


@pytest.mark.parametrize("name", RUNS)
def test_a_recorded_run_is_equal_to_its_end(name: str, tmp_path: Path) -> None:
    tables, happens = RUNS[name]
    seen: list[SeenSteps] = []
    with recorded(configuration(tables), tmp_path, lambda daemon: seen.append(SeenSteps(daemon))) as plc:
        happens(plc)
    results = replay_of(tmp_path)
    assert seen[0].compare(recording(tmp_path)) > 100
    assert not differences(results)
    assert len(results) == tables.count("do_id")
    assert all(result.steps > 200 for result in results)


def test_a_drive_without_profile_velocity_is_replayed(tmp_path: Path) -> None:
    with recorded(configuration(axis(1, more="")), tmp_path) as plc:
        world_of(plc.daemon).drive("world", 1, shape=shape("vl"))
        until(plc.daemon, lambda: plc.daemon.axes[0].drive.generation, "online")
        plc.enable()
        plc.endpoint.set(0, {"NSOLL_A": -0x1000})
        plc.exchange(100)
    assert not differences(replay_of(tmp_path))


def test_a_drive_whose_speed_is_read_by_sdo_is_replayed_with_its_late_answers(tmp_path: Path) -> None:
    with recorded(configuration(axis(1, more="")), tmp_path) as plc:
        drive = world_of(plc.daemon).drive("world", 1, shape=shape("speed-by-sdo"))
        until(plc.daemon, lambda: plc.daemon.axes[0].drive.generation, "online")
        plc.enable()
        plc.endpoint.set(0, {"NSOLL_A": 0x3300})
        plc.exchange(100)
        drive.do(lambda node: node.start_fault("sdo-answers-of-object-late"))
        plc.exchange(50)
        plc.endpoint.set(0, {"STW1": OFF})
        plc.until(lambda: plc.state() == 1, "off")
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


def changed(folder: Path, kind: str, change: Callable[[bytearray], None], *, recorded: bool = False) -> list[Replayed]:
    """The replay of a recording in which one frame of a kind in operation is another one. ``recorded``: the last one before a
    step that is recorded with its values."""
    file = Path(recording(folder))
    data = bytearray(file.read_bytes())
    found, last = [], []
    for block, at, length in pcapng.walk(bytes(data)):
        if block == pcapng.PACKET:
            begin = at + pcapng.PACKET_HEAD.size
            (identifier,) = struct.unpack_from(">I", data, begin)
            is_answer = data[begin + 42 : begin + 44] == b"\xc0\x00"
            if {"RPDO": identifier == 0x201, "TPDO": identifier == 0x181, "answer": is_answer}[kind]:
                last = [(begin, at + length - 4)]
                found += [] if recorded else last
        elif recorded and block == pcapng.CUSTOM and (cycle := pcapng.cycle_at(bytes(data), at)):
            found += last if cycle[1] & pcapng.WHOLE else []
            last = []
    begin, end = found[len(found) // 2 if recorded else len(found) // 3]
    frame = data[begin:end]
    change(frame)
    data[begin:end] = frame
    file.write_bytes(data)
    return replayed([str(file)])


@pytest.fixture(scope="module")
def turning(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording of an axis that turns at changing speeds for some seconds."""
    folder = tmp_path_factory.mktemp("turning")
    with recorded(configuration(axis(1)), folder) as plc:
        plc.enable()
        for number in range(800):
            plc.endpoint.set(0, {"NSOLL_A": 0x1000 + 16 * (number % 60)})
            plc.exchange()
    return folder


@pytest.mark.parametrize(
    ("kind", "place", "field", "before_a_record"),
    [
        ("RPDO", 8, "target_velocity in the RPDO", False),
        ("RPDO", 8, "target_velocity in the RPDO", True),
        ("TPDO", 8, "statusword in the TPDO", True),
        ("TPDO", 10, "velocity_actual in the TPDO", True),
        ("answer", 47, "NIST_A", False),
    ],
)
def test_a_changed_frame_is_the_difference(
    kind: str, place: int, field: str, before_a_record: bool, turning: Path
) -> None:
    def change(frame: bytearray) -> None:
        frame[place] ^= 0x15

    found = changed(turning, kind, change, recorded=before_a_record)[0].differences
    assert field in found[0].field


@pytest.mark.parametrize(("place", "field"), [(8, "released"), (10, "NIST_A")])
def test_a_changed_input_between_two_records_changes_decisions(place: int, field: str, turning: Path) -> None:
    def change(frame: bytearray) -> None:
        frame[place] ^= 0x15

    assert changed(turning, "TPDO", change)[0].differences[0].field == field


def items_of(name: str, folder: Path) -> list[Description | Frame | Cycle]:
    """The blocks of a run that this version records."""
    tables, happens = RUNS[name]
    with recorded(configuration(tables), folder) as plc:
        happens(plc)
    return list(Parser(name).feed(Path(recording(folder)).read_bytes()))


MISSING = {"acknowledged": "telegram 1", "faults": "telegram 1", "log_lines": "telegram 1", "orders": "telegram 9"}
"""The events of a step, each with a run that has it."""


def test_each_event_of_a_drive_that_sends_emcy_is_missing_once() -> None:
    assert MISSING.keys() == {*EVENTS, "orders"} - {"read_fault"}


@pytest.mark.parametrize("kind", MISSING)
def test_a_missing_event_is_the_difference(kind: str, tmp_path: Path) -> None:
    items = items_of(MISSING[kind], tmp_path)
    cycles = [(place, item) for place, item in enumerate(items) if isinstance(item, Cycle)]
    place, cycle, step = next((place, item, item.steps[0]) for place, item in cycles if kind in item.steps[0].events)
    events = {key: value for key, value in step.events.items() if key != kind}
    without = cycle._replace(steps=(step._replace(events=events),))
    first = differences(replay([*items[:place], without]))[0]
    assert first.field == kind
    assert first.recorded == []


def test_a_recording_with_a_gap_is_refused(tmp_path: Path) -> None:
    items = items_of("telegram 1", tmp_path)
    cycles = [place for place, item in enumerate(items) if isinstance(item, Cycle)]
    del items[cycles[200]], items[cycles[150]]
    with pytest.raises(GatewayError, match="the recording has a gap of 1 cycles"):
        replay(items)


def test_a_part_of_a_recording_is_refused(tmp_path: Path) -> None:
    with recorded(configuration(axis(1)), tmp_path) as plc:
        plc.exchange(1200)
        reader = RingReader(tmp_path / "test.ring")
        newest = reader.cycles(at_most=1)[0].time_ns
        save(reader, tmp_path / "part.pcapng", newest - 1_000_000_000)
    with pytest.raises(GatewayError, match=r"begins in the middle of a run.*--record"):
        replayed([str(tmp_path / "part.pcapng")])


def test_a_capture_of_another_recorder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x.pcapng").write_bytes(pcapng.section("", ("can",)))
    with pytest.raises(GatewayError, match="only a recording of the gateway itself can be replayed"):
        replayed([str(tmp_path / "x.pcapng")])
    (tmp_path / "x.log").write_text("(1.0) can0 1#00\n" * 9)
    with pytest.raises(GatewayError, match="not a recording of the gateway"):
        replayed([str(tmp_path / "x.log")])


LONGEST_NS = 20 * SECOND
"""Of a scenario without an end."""
SCENARIOS = {path.name: path.read_text() for path in (ROOT / "tools" / "scenarios").glob("[!d]*.yaml")} | {
    item.name: item.text
    for path in DOCUMENTS
    for item in steps(path.read_text())
    if isinstance(item, File) and item.name.endswith(".yaml")
}


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_scenario_is_replayed_equal(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text(SCENARIOS[name])
    scenario = load_scenario(path)
    with recorded(simulated(scenario.telegrams), tmp_path) as plc:
        engine = Engine(scenario, plc.endpoint)
        while not engine.finished and plc.loop.now() < LONGEST_NS:
            engine.step(plc.loop.now())
            plc.exchange()
        assert engine.passed, [result for result in engine.results if not result.passed]
    for result in replay_of(tmp_path):
        assert not differences([result])
        assert result.steps > 700


@pytest.fixture(scope="module")
def recorded_on_profinet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Enable, speed, OFF1, PLC in STOP, silence, release and a second connection that writes the parameters again."""
    folder = tmp_path_factory.mktemp("recorded_on_profinet")
    config = profinet_daemon.configuration(axis(1) + axis(2, telegram_number=9), folder / "store.json")
    seen: list[SeenSteps] = []

    def before(daemon: Daemon) -> None:
        seen.append(SeenSteps(daemon))
        record(daemon, folder)

    with profinet_daemon.plant(config, data_hold=400, before=before) as site:
        site.connect()
        site.run(100 * MS)
        site.enable(1, 0x1000)
        site.run(300 * MS)
        site.set(1, OFF, 0x1000)
        site.run(500 * MS)
        site.enable(1, 0x0800)
        site.run(100 * MS)
        assert site.plc.provider is not None
        site.plc.provider.data_status &= ~STATUS_RUN
        site.run(500 * MS)
        site.plc.provider.data_status |= STATUS_RUN
        site.enable(1, 0x0800)
        site.run(100 * MS)
        site.plc.silent = True
        site.run(300 * MS)
        site.plc.silent = False
        site.enable(1, 0x0800)
        site.plc.release(site.loop.now())
        site.run(500 * MS)
        site.connect()
        site.enable(1, 0x0800)
        site.run(100 * MS)
        site.set(1, OFF)
        site.run(300 * MS)
        site.enable(1, 0x0800)
        site.run(100 * MS)
        profinet_daemon.parameterise_again(site)
        site.run(300 * MS)
    assert seen[0].compare(recording(folder)) > 500
    return folder


def printed(folder: Path) -> list[str]:
    """The timeline's lines."""
    found = own_timeline(recording(folder))
    return ["".join(entry_lines(entry, found.opening.begin_ns)) for entry in found.entries]


def test_a_recording_is_equal(recorded_on_profinet: Path) -> None:
    for result in replay_of(recorded_on_profinet):
        assert not result.differences
        assert result.steps > 500


def test_timeline_shows_relationships_stops_and_losses(recorded_on_profinet: Path) -> None:
    lines = printed(recorded_on_profinet)

    def has(*parts: str) -> int:
        return sum(all(part in line for part in parts) for line in lines)

    assert has("relationship of plc-1 and press-1 granted") == 2
    assert has("relationship of plc-1 and press-1 confirmed: cyclic data is valid") == 2
    assert has("relationship of plc-1 and press-1 ended") == 1
    assert has("relationship of plc-1 and press-1 parameterised again: cyclic data is not valid") == 1
    assert has("provider stop") == 1
    assert has("no frame of the PLC for more than 12 ms") == 1
    assert has("axis 1", "PLC lost: the gateway stops the drive") == 4, (
        "in STOP, in silence, after Release and PrmBegin"
    )
    assert has("axis 1", "diagnosis, slot 1.1, Communication error to the higher-level control system appears") == 2
    assert has("axis 2", "diagnosis, slot 2.1, Communication error to the higher-level control system appears") == 2
    assert has("STW1", "047Eh -> 047Fh", "-> executed") == 6
