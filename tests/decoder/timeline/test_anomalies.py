"""Anomalies of a timeline: what went wrong on either bus, and where today's rules differ from the recorded ones."""

from __future__ import annotations

import random
import re
import tracemalloc
from dataclasses import replace
from pathlib import Path

import pytest

from pdgw.decoder.frames.canopen.records import NmtRecord, PdoRecord
from pdgw.decoder.frames.engine import Decoder, Settings, given_axes
from pdgw.decoder.frames.link import CanFrame
from pdgw.decoder.timeline.axis import AGREEMENT_NS, NOT_JUDGED, AxisFollower
from pdgw.decoder.timeline.builder import HOLD_NS, TimelineBuilder
from pdgw.decoder.timeline.entries import AnomalyKind, Event, ReasonChange, WordKind
from pdgw.decoder.timeline.words import Decision, Words
from pdgw.dsp402.states import State
from pdgw.durations import MS
from pdgw.gateway.axis.settings import AxisSettings
from pdgw.gateway.links.cyclic import CyclicEndpoint
from pdgw.gateway.reasons import Reason
from pdgw.profidrive.frame import COUNTER_UNIT_NS
from pdgw.profidrive.telegrams import telegram
from pdgw.recording.recordings import followed, look_ahead
from tests.decoder.replay.test_replay import positioning, speed
from tests.support.axis.recorded import BEGIN_NS, CYCLE_NS, MACS, RecordedRig, stopping
from tests.support.axis.rig import NODE
from tests.support.readers import captures
from tests.support.readers.timeline import Timeline, edges, texts, timeline


def test_a_command_the_drive_does_not_answer_is_a_missed_handshake(tmp_path: Path) -> None:
    rig = RecordedRig(1)
    rig.node.model.set_enable_input(False)
    rig.stw(0x047E, 5)
    rig.stw(0x047F, 300)
    assert rig.state is State.SWITCHED_ON
    (text,) = texts(timeline(rig, tmp_path), AnomalyKind.HANDSHAKE)
    assert text.startswith("Controlword 000Fh [Enable Operation]: the drive did not respond within 1 s, Statusword ")
    assert text.endswith("[Switched On]")


def test_unconfirmed_mode_is_reported(tmp_path: Path) -> None:
    rig = RecordedRig(100)
    rig.node.misbehave("mode-display-stuck")
    rig.stw(0)
    rig.values["Modes of Operation"] = 3
    rig.step(300)
    assert texts(timeline(rig, tmp_path), AnomalyKind.MODE) == ["6060h = 3, 6061h = 1 for 1 s"]


def test_counter_jump_is_reported_with_the_number_of_missing_frames(tmp_path: Path) -> None:
    rig = speed()
    del rig.frames.plc[30:32]
    assert texts(timeline(rig, tmp_path), AnomalyKind.COUNTER) == [
        "PLC -> gateway: counter 3840 -> 4224, usual step 128, 2 frames missing"
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
    assert texts(timeline(rig, tmp_path), AnomalyKind.STALE) == ["frame with counter 3968: stale cycle counter"]


def test_a_silence_of_the_plc_is_a_watchdog_gap(tmp_path: Path) -> None:
    rig = speed()
    rig.step(10, plc=False)
    rig.step(5)
    found = timeline(rig, tmp_path)
    assert texts(found, AnomalyKind.WATCHDOG) == [
        "no frame of the PLC for 16.3 ms: the gateway has lost the PLC (IOCS BAD)"
    ]
    assert "frames are back after 44.0 ms" in [entry.text for entry in found.entries if isinstance(entry, Event)]
    assert Reason.PLC_LOST in {entry.reason for entry in found.entries if isinstance(entry, ReasonChange)}


def ended(rig: RecordedRig) -> None:
    """The PLC ends, and the gateway a moment later: it uses no frame any more, the last one neither."""
    rig.step(plc=False)
    rig.endpoint.lose_setpoints()
    rig.step(5, plc=False)


def test_gateway_that_ends_after_the_plc_reports_no_loss(tmp_path: Path) -> None:
    rig = speed()
    ended(rig)
    found = timeline(rig, tmp_path)
    assert not texts(found, AnomalyKind.WATCHDOG)
    told = [entry.text for entry in found.entries if isinstance(entry, Event) and entry.kind == "gateway"]
    assert told == [
        "no frame of the PLC for 8.3 ms, less than the watchdog time of 12 ms: IOCS BAD as when the gateway ends"
    ]
    assert Reason.PLC_LOST in {entry.reason for entry in found.entries if isinstance(entry, ReasonChange)}


def test_without_its_watchdog_the_end_of_a_gateway_looks_like_a_loss(tmp_path: Path) -> None:
    rig = speed()
    ended(rig)
    opening = rig.open(tmp_path)
    opening = replace(opening, known=replace(opening.known, watchdog_factor=None))
    found = Timeline(opening, list(followed(opening)))
    assert texts(found, AnomalyKind.WATCHDOG) == [
        "no frame of the PLC for 8.3 ms: the gateway has lost the PLC or is ending (IOCS BAD)"
    ]


@pytest.mark.parametrize(("word", "controlword"), [(0x047D, 0x0), (0x047B, 0x2)], ids=["OFF2", "OFF3"])
def test_stops_of_the_plc_count_while_the_gateway_stops(word: int, controlword: int, tmp_path: Path) -> None:
    found = timeline(stopping(word), tmp_path)
    assert texts(found, AnomalyKind.DROPPED) == [
        "the gateway uses only OFF2 and OFF3 of the frames (IOCS BAD), as while it is being stopped"
    ]
    assert found.summary.anomalies.total() == 1, "the recorded Controlword is that of this version"
    edge = next(
        edge for edge in edges(found, WordKind.CONTROLWORD) if edge.cause is not None and edge.cause.after == word
    )
    assert edge.after & 0xF == controlword


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
    resets = [entry for entry in found.entries if isinstance(entry, Event) and entry.kind == "EMCY"]
    assert [entry.text.split()[2] for entry in resets] == ["0000h"]


def test_drive_that_leaves_operation_by_itself_is_reported(tmp_path: Path) -> None:
    rig = RecordedRig(1)
    rig.step(5)
    rig.enable(0x047E)
    rig.node.model.set_enable_input(False)
    rig.step(20)
    (text,) = texts(timeline(rig, tmp_path), AnomalyKind.LEFT_OPERATION)
    assert text.endswith("while Enable Operation was commanded")


def test_a_silence_the_gateway_tolerates_is_no_loss(tmp_path: Path) -> None:
    rig = RecordedRig(1)
    rig.endpoint = CyclicEndpoint([rig.stepper.telegram], cycle_ns=CYCLE_NS, watchdog_factor=20)
    rig.step(5)
    rig.enable(0x047E)
    rig.step(10, plc=False)
    rig.step(20)
    found = timeline(rig, tmp_path)
    assert not found.summary.anomalies
    assert edges(found, WordKind.CONTROL)[-1].outcome is None


@pytest.mark.parametrize("factor", [3, None])
def test_without_answers_the_watchdog_decides_and_is_named(factor: int | None, tmp_path: Path) -> None:
    rig = speed()
    rig.step(10, plc=False)
    rig.step(5)
    rig.frames.answers.clear()
    opening = rig.open(tmp_path)
    opening = replace(opening, known=replace(opening.known, watchdog_factor=factor))
    found = Timeline(opening, list(followed(opening)))
    whose = "the watchdog's" if factor else "if the watchdog has its default"
    assert texts(found, AnomalyKind.WATCHDOG) == [f"no frame of the PLC for 44.0 ms: lost after 12 ms, {whose}"]


def test_frames_rejected_by_the_gateway_are_reported_once(tmp_path: Path) -> None:
    rig = RecordedRig(1)
    unknown_sender = CyclicEndpoint([rig.stepper.telegram], cycle_ns=CYCLE_NS, peer="192.0.2.1")
    rig.endpoint = unknown_sender
    rig.step(60)
    assert texts(timeline(rig, tmp_path), AnomalyKind.DROPPED) == ["the gateway does not use the frames (IOCS BAD)"]


def shutdown_for_ever(rig: RecordedRig) -> int:
    """The recorded gateway sends Shutdown where today's rules enable; the time it begins."""
    sent = [item for item in rig.frames.can if item[1] == 0x200 + NODE]
    begin = next(now for now, _, data in sent if data[-2] == 0x0F)
    for position, (now, cob_id, data) in enumerate(rig.frames.can):
        if cob_id == 0x200 + NODE and now >= begin:
            rig.frames.can[position] = (now, cob_id, data[:-2] + b"\x06\0")
    return begin


def one_file(rig: RecordedRig, folder: Path) -> Timeline:
    """The timeline of a recording of both buses with one clock."""
    frames = rig.frames
    packets = [(BEGIN_NS + now, captures.ETHERNET, MACS + data) for now, data in (*frames.plc, *frames.answers)]
    packets += [
        (BEGIN_NS + now, captures.SOCKETCAN, captures.socketcan_packet(cob_id, data))
        for now, cob_id, data in frames.can
    ]
    path = folder / "both.pcapng"
    path.write_bytes(captures.pcapng(sorted(packets)))
    opening = look_ahead([str(path)], rig.known, None, lambda _: None)
    return Timeline(opening, list(followed(opening)))


def test_a_step_of_which_only_the_rpdo_was_recorded_is_no_difference(tmp_path: Path) -> None:
    """A busy gateway steps by its timer and sends the RPDO; the answer to the PLC is that of a later step."""
    rig = speed()
    enabled = next(now for now, cob_id, data in rig.frames.can if cob_id == 0x200 + NODE and data[4] == 0x0F)
    for frames in (rig.frames.plc, rig.frames.answers):
        frames[:] = [frame for frame in frames if not enabled - MS <= frame[0] <= enabled + MS]
    found = one_file(rig, tmp_path)
    assert texts(found, AnomalyKind.DIFFERENCE) == texts(found, AnomalyKind.GATEWAY_FAULT) == []
    on = next(edge for edge in edges(found, WordKind.CONTROL) if edge.after == 0x047F)
    assert on.outcome is None
    enable = next(edge for edge in edges(found, WordKind.CONTROLWORD) if edge.after == 0x000F)
    assert enable.cause is not None
    assert enable.cause.kind is WordKind.STATUSWORD


@pytest.mark.parametrize("one_clock", [False, True])
def test_with_one_clock_no_edge_comes_before_its_cause(one_clock: bool) -> None:
    words = Words(1, telegram(1), 2 * CYCLE_NS, lambda _: None, one_clock=one_clock)
    for kind, word in ((WordKind.CONTROLWORD, 0x000F), (WordKind.STATUSWORD, 0x1637)):
        words.edge(kind, 0, word)
    stop = words.edge(WordKind.CONTROLWORD, 5 * MS, 0x0002)
    answer = words.edge(WordKind.STATUSWORD, 6 * MS, 0x1617)
    assert stop is not None
    words.explain(WordKind.CONTROLWORD, stop)
    # A step after both decides what was sent before the answer: with two clocks their order is unknown.
    words.decided(WordKind.CONTROLWORD, Decision(8 * MS, 0x000F, 0x0002, answer))
    assert stop.cause is (None if one_clock else answer)


def test_no_reasons_are_shown_where_present_rules_differ_for_longer(tmp_path: Path) -> None:
    rig = RecordedRig(1)
    rig.step(5)
    rig.enable(0x047E)
    rig.step(200)
    rig.stw(0x043F, 30)
    begin = BEGIN_NS + shutdown_for_ever(rig)
    found = timeline(rig, tmp_path)
    (text,) = texts(found, AnomalyKind.DIFFERENCE)
    assert text.endswith("by the rules of this version: no reasons until an OFF")
    assert edges(found, WordKind.CONTROL)[-1].note == NOT_JUDGED
    told = [entry.time_ns for entry in found.entries if isinstance(entry, ReasonChange)]
    assert max(told) < begin + AGREEMENT_NS + 10 * MS


def test_recording_that_starts_in_operation_has_no_reasons_before_an_off(tmp_path: Path) -> None:
    rig = RecordedRig(1)
    rig.step(5)
    rig.enable(0x047E)
    begin = rig.now
    rig.step(10)
    rig.values["NSOLL_A"] = 0x1000
    rig.step(60)
    rig.stw(0x043F, 20)
    rig.stw(0x047E, 200)
    rig.stw(0x047F, 30)
    frames = rig.frames
    frames.plc, frames.answers = ([item for item in part if item[0] > begin] for part in (frames.plc, frames.answers))
    frames.can = [item for item in frames.can if item[0] > begin]
    found = timeline(rig, tmp_path)
    first, off, on = edges(found, WordKind.CONTROL)
    assert first.note == NOT_JUDGED
    assert (on.note, on.outcome) == ("", None)
    told = [entry.time_ns for entry in found.entries if isinstance(entry, ReasonChange)]
    assert min(told) > off.time_ns
    assert not found.summary.anomalies


def test_a_tpdo_that_repeats_itself_after_an_nmt_start_shows_the_drive_online() -> None:
    decoder = Decoder(Settings(axes=given_axes([1])))
    follower = AxisFollower(
        decoder.axes[0], AxisSettings(), lambda _: None, cycle_ns=4 * MS, hold_ns=0, one_clock=True, assumed=True
    )
    shown = []
    frames = ((0x000, "0201"), (0x181, "370600000000"), (0x000, "0101"), (0x181, "370600000000"))
    for number, (cob_id, data) in enumerate(frames):
        record = decoder.decode_can(number, number, "can0", CanFrame(cob_id, bytes.fromhex(data)))
        assert isinstance(record, NmtRecord | PdoRecord)
        follower.take(record)
        shown.append(follower.online)
    assert shown == [False, False, False, True]


def test_memory_does_not_grow_with_the_recording(tmp_path: Path) -> None:
    rig = positioning()
    opening = rig.open(tmp_path)
    records = list(opening.records())
    length = records[-1].time_ns - records[0].time_ns + CYCLE_NS
    builder = TimelineBuilder(opening.known.settings.axes, opening.known.choices, cycle_ns=CYCLE_NS)
    sizes = []
    tracemalloc.start()
    try:
        for _ in range(12):
            for record in records:
                for entry in builder.add(record):
                    assert entry.time_ns <= record.time_ns - HOLD_NS
                record.time_ns += length
            sizes.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    assert sizes[-1] - sizes[3] < 200_000, "packets kept would be megabytes"
