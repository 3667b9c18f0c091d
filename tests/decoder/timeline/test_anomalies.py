"""Anomalies and rejections of a timeline: what the frames of both buses show, and what the gateway decided."""

from __future__ import annotations

import random
import re
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from pdgw.base.durations import MS
from pdgw.dsp402.states import State
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.links.cyclic import CyclicEndpoint
from pdgw.profidrive.frame import COUNTER_UNIT_NS
from pdgw.tools.decoder.timeline.builder import HOLD_NS, TimelineBuilder
from pdgw.tools.decoder.timeline.entries import Anomaly, AnomalyKind, Event, ReasonChange, WordKind
from pdgw.tools.decoder.timeline.text import entry_lines
from pdgw.tools.recording.recordings import look_ahead
from tests.support.axis.recorded import CYCLE_NS, RecordedRig, positioning, speed
from tests.support.axis.rig import NODE
from tests.support.gateways.daemon import ON, Plc, axis, configuration, drive_of
from tests.support.gateways.recorded_daemon import recorded, recording
from tests.support.readers.timeline import Timeline, edges, entries_of, own_timeline, texts, timeline


def test_a_command_the_drive_does_not_answer_is_a_missed_handshake(tmp_path: Path) -> None:
    rig = RecordedRig(1)
    rig.node.model.set_enable_input(False)
    rig.stw(0x047E, 5)
    rig.stw(0x047F, 300)
    assert rig.state is State.SWITCHED_ON
    (text,) = texts(timeline(rig, tmp_path), AnomalyKind.HANDSHAKE)
    assert text.startswith("Controlword 000Fh [Enable Operation]: the drive did not respond within 1 s, Statusword ")
    assert text.endswith("[Switched On]")


def test_counter_jump_is_reported_with_the_number_of_missing_frames(tmp_path: Path) -> None:
    rig = speed()
    del rig.frames.plc[30:32]
    assert texts(timeline(rig, tmp_path), AnomalyKind.COUNTER) == [
        "PLC -> gateway: counter 3840 -> 4224, usual step 128, missing frames: 2"
    ]


@pytest.mark.parametrize("often", [1, 10])
def test_a_cycle_counter_may_be_a_clock_of_a_plc_that_is_late(often: int, tmp_path: Path) -> None:
    rig = speed()
    noise = random.Random(1)
    counted = []
    for cycle, (now, frame) in enumerate(rig.frames.plc):
        late = 0 if cycle % often else noise.randint(0, 2 * MS)
        counter = (now + late) // COUNTER_UNIT_NS & 0xFFFF
        counted.append((now, frame[:-4] + counter.to_bytes(2, "big") + frame[-2:]))
    rig.frames.plc = counted
    assert not texts(timeline(rig, tmp_path), AnomalyKind.COUNTER)
    now, frame = counted[40]
    ahead = (int.from_bytes(frame[-4:-2], "big") + 200 * MS // COUNTER_UNIT_NS) & 0xFFFF
    counted[40] = (now, frame[:-4] + ahead.to_bytes(2, "big") + frame[-2:])
    text = texts(timeline(rig, tmp_path), AnomalyKind.COUNTER)[0]
    assert re.search(r"counter \d+ -> \d+ claims 20\d\.\d ms, but 4\.0 ms have passed", text)


def test_a_repeated_frame_is_stale(tmp_path: Path) -> None:
    rig = speed()
    now, frame = rig.frames.plc[30]
    rig.frames.plc.insert(31, (now + MS, frame))
    assert texts(timeline(rig, tmp_path), AnomalyKind.STALE) == ["PLC -> gateway: counter 3968 after 3968"]


def test_a_silence_of_the_plc_is_a_watchdog_gap(tmp_path: Path) -> None:
    rig = speed()
    rig.step(10, plc=False)
    rig.step(5)
    found = timeline(rig, tmp_path)
    text = "no frame of the PLC for more than 12 ms, the time of the watchdog"
    assert texts(found, AnomalyKind.WATCHDOG) == [text]
    assert "frames are back after 44.0 ms" in [entry.text for entry in found.entries if isinstance(entry, Event)]


def test_emergencies_and_their_reset_are_reported(tmp_path: Path) -> None:
    rig = speed()
    rig.node.model.inject(7)
    rig.step(20)
    rig.node.model.clear()
    rig.stw(0x047E)
    rig.stw(0x04FE)
    found = timeline(rig, tmp_path)
    (text,) = texts(found, AnomalyKind.EMERGENCY)
    assert text.startswith(f"node {NODE}: 2310h")
    resets = [entry for entry in found.entries if type(entry) is Event and entry.kind == "EMCY"]
    assert [entry.text.split()[2] for entry in resets] == ["0000h"]


def test_drive_that_leaves_operation_by_itself_is_reported(tmp_path: Path) -> None:
    rig = RecordedRig(1)
    rig.step(5)
    rig.enable(0x047E)
    rig.node.model.set_enable_input(False)
    rig.step(20)
    (text,) = texts(timeline(rig, tmp_path), AnomalyKind.LEFT_OPERATION)
    assert text.endswith("while Enable Operation was commanded")


def test_without_a_configuration_the_watchdog_is_assumed(tmp_path: Path) -> None:
    rig = speed()
    rig.step(10, plc=False)
    rig.step(5)
    files = rig.frames.write(tmp_path)
    opening = look_ahead(files, replace(rig.known, cycle_ns=None), None, lambda _: None)
    found = Timeline(opening, entries_of(opening))
    assert opening.assumed == ("a watchdog of 3 cycles of the PLC",)
    assert texts(found, AnomalyKind.WATCHDOG) == ["no frame of the PLC for more than 12 ms, the time of the watchdog"]


def test_frames_rejected_by_the_gateway_are_reported_once(tmp_path: Path) -> None:
    rig = RecordedRig(1)
    unknown_sender = CyclicEndpoint([rig.stepper.telegram], cycle_ns=CYCLE_NS, peer="192.0.2.1")
    rig.endpoint = unknown_sender
    rig.step(60)
    assert texts(timeline(rig, tmp_path), AnomalyKind.DROPPED) == ["the gateway does not use the frames (IOCS BAD)"]


def test_data_that_the_plc_marks_as_bad_is_reported_with_its_end(tmp_path: Path) -> None:
    rig = speed()
    rig.plc.bad = {0}
    rig.step(5)
    rig.plc.bad = set()
    rig.step(5)
    found = timeline(rig, tmp_path)
    assert texts(found, AnomalyKind.IOPS_BAD) == ["data of the PLC bad"]
    (event,) = (entry for entry in found.entries if isinstance(entry, Event) and entry.kind == "IOPS")
    assert event.text == "data of the PLC good again after 20.0 ms"


def test_memory_does_not_grow_with_the_recording(tmp_path: Path) -> None:
    rig = positioning()
    opening = rig.open(tmp_path)
    records = list(opening.records())
    length = records[-1].time_ns - records[0].time_ns + CYCLE_NS
    builder = TimelineBuilder(opening.known.settings.axes, cycle_ns=CYCLE_NS)
    sizes = []
    tracemalloc.start()
    try:
        for turn in range(8):
            for record in records:
                later = replace(record, time_ns=record.time_ns + turn * length)
                for entry in builder.add(later):
                    assert entry.time_ns <= later.time_ns - HOLD_NS
            sizes.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    assert sizes[-1] - sizes[3] < 200_000, "packets kept would be megabytes"


def run(plc: Plc, word: int | None = None, cycles: int = 40, **values: int) -> None:
    """Some cycles with other setpoints."""
    plc.endpoint.set(0, ({} if word is None else {"STW1": word}) | values)
    for _ in range(cycles):
        plc.exchange()


def timeline_of(folder: Path, happens: Callable[[Plc], None]) -> Timeline:
    """What happened once the drive was online."""
    with recorded(configuration(axis(1)), folder) as plc:
        plc.until(lambda: plc.state() == 0x40, "online")
        happens(plc)
        file = recording(folder)
    return own_timeline(file)


def without_off(plc: Plc) -> None:
    run(plc, ON)


def no_control(plc: Plc) -> None:
    plc.enable()
    run(plc, 0x007E)


def setpoint_disabled(plc: Plc) -> None:
    plc.enable()
    run(plc, 0x043F)


def coast(plc: Plc) -> None:
    run(plc, 0x047E)
    run(plc, 0x047C)


def ramp(plc: Plc) -> None:
    plc.enable()
    run(plc, NSOLL_A=0x4000, cycles=150)
    run(plc, 0x047E, 8)
    run(plc, ON)


def quick_stop(plc: Plc) -> None:
    plc.enable()
    run(plc, NSOLL_A=0x4000, cycles=150)
    run(plc, 0x047B)


def fault(plc: Plc) -> None:
    plc.enable()
    drive_of(plc.daemon).inject(7)
    run(plc)
    run(plc, 0x047E)


REFUSALS: dict[Reason, Callable[[Plc], None]] = {
    Reason.NEEDS_OFF: without_off,
    Reason.NO_CONTROL: no_control,
    Reason.SETPOINT_DISABLED: setpoint_disabled,
    Reason.COAST_STOP: coast,
    Reason.RAMP_STOP: ramp,
    Reason.QUICK_STOP: quick_stop,
    Reason.DRIVE_FAULT: fault,
}


@pytest.mark.parametrize("reason", REFUSALS)
def test_each_refusal_is_explained_with_the_gateways_text(reason: Reason, tmp_path: Path) -> None:
    found = timeline_of(tmp_path, REFUSALS[reason])
    edge = edges(found, WordKind.CONTROL)[-1]
    assert edge.outcome is reason
    assert reason.value in "\n".join(entry_lines(edge, found.opening.begin_ns))
    document = edge.document()
    assert (document["outcome"], document["outcome_text"]) == (reason.name, reason.value)
    is_effect = reason in {Reason.COAST_STOP, Reason.QUICK_STOP}
    assert bool(found.summary.refusals[reason]) is not is_effect
    assert Reason.SWITCHED_OFF not in found.summary.refusals, "an OFF that works is no refusal"


def test_a_start_is_executed_and_a_fault_has_its_own_line(tmp_path: Path) -> None:
    def happens(plc: Plc) -> None:
        plc.enable()
        run(plc)
        drive_of(plc.daemon).inject(7)
        run(plc)

    found = timeline_of(tmp_path, happens)
    on = next(edge for edge in edges(found, WordKind.CONTROL) if edge.after == ON)
    assert "-> executed" in "\n".join(entry_lines(on, found.opening.begin_ns))
    changes = [entry for entry in found.entries if isinstance(entry, ReasonChange)]
    assert changes[-1].reason is Reason.DRIVE_FAULT
    assert not changes[-1].settling
    assert not any(isinstance(entry, Anomaly) and entry.kind is AnomalyKind.GATEWAY_FAULT for entry in found.entries)


def test_a_lost_plc_is_a_fault_of_the_gateway_and_the_reason(tmp_path: Path) -> None:
    def happens(plc: Plc) -> None:
        plc.enable()
        run(plc)
        plc.endpoint.set(0, {"STW1": ON & ~0x400})
        run(plc, cycles=20)
        plc.enable()
        plc.silent = True
        run(plc, cycles=200)

    found = timeline_of(tmp_path, happens)
    faults = [
        item.text for item in found.entries if isinstance(item, Anomaly) and item.kind is AnomalyKind.GATEWAY_FAULT
    ]
    assert any(text.startswith(str(int(FaultNumber.CONTROL_LOST))) for text in faults)
    reasons = [entry.reason for entry in found.entries if isinstance(entry, ReasonChange)]
    assert {Reason.NO_CONTROL, Reason.PLC_LOST} <= set(reasons)
