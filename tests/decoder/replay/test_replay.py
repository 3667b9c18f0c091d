"""Replay: equal on what today's gateway made, a named first difference on anything else."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from pdgw.decoder.replay.plc_inputs import Frame, receive_frames
from pdgw.decoder.replay.recorded import AxisRecording
from pdgw.decoder.replay.replay import Replayer
from pdgw.dsp402.drive.images import DriveCommand, DriveFeedback, attributes
from pdgw.durations import MS
from pdgw.gateway.axis.settings import AxisSettings, SetpointEnable
from pdgw.gateway.axis.telegrams import DRIVE_TELEGRAM_NUMBERS
from pdgw.gateway.links.cyclic import CyclicEndpoint
from pdgw.gateway.links.new_frames import Verdict
from pdgw.gateway.motion.dsc import DscChoices, DscForm
from pdgw.profidrive.frame import STATUS_STOP, TRAILER
from pdgw.profidrive.telegrams import telegram
from pdgw.recording.recordings import Loaded, load
from tests.support.axis.recorded import CYCLE_NS, RecordedRig, known, stopping
from tests.support.axis.rig import NODE, Rig
from tests.support.axis.stepper import Stepper
from tests.support.drives.drive_types import References
from tests.support.drives.plain_drive import PlainDrive

RPDO1 = 0x200 + NODE


def speed(number: int = 1, **settings: object) -> RecordedRig:
    """Start, speed, OFF1 ramp, start again, quick stop."""
    rig = RecordedRig(number, **settings)
    rig.step(5)
    rig.enable(0x047E)
    name = rig.stepper.telegram.setpoints.names[1]
    rig.values[name] = 0x1000 if number == 1 else 0x10000000
    rig.step(60)
    rig.stw(0x047E, 80)
    rig.stw(0x047F, 20)
    rig.stw(0x047B, 60)
    return rig


def positioning(sdo_delay: int | None = None) -> RecordedRig:
    """Homing, a relative task on the fly, intermediate stop and resume, reject."""
    rig = RecordedRig(9)
    if sdo_delay is not None:
        rig.sdo_delay = sdo_delay
    rig.step(5)
    rig.enable()
    rig.values["SATZANW"] = 0x8000 | 35
    rig.stw(0x0C3F, 30)
    rig.stw(0x043F)
    rig.values |= {
        "MDI_TARPOS": 0x08000000,
        "MDI_VELOCITY": 0x40000000,
        "MDI_ACC": 0x4000,
        "MDI_DEC": 0x4000,
        "MDI_MOD": 1,
    }
    rig.stw(0x047F, 30)
    rig.values |= {"MDI_TARPOS": 0x04000000, "MDI_MOD": 0}
    rig.stw(0x043F, 10)
    rig.stw(0x047F, 20)
    rig.stw(0x045F, 40)
    rig.stw(0x047F, 60)
    rig.stw(0x046F, 40)
    return rig


def transparent() -> RecordedRig:
    """Velocity mode over telegram 100."""
    rig = RecordedRig(100)
    for word in (0, 6, 7, 15):
        rig.stw(word)
    rig.values |= {"Modes of Operation": 3, "Target Velocity": 2000, "Profile Acceleration": 300}
    rig.step(60)
    rig.stw(0, 20)
    return rig


RIGS: dict[str, Callable[[], RecordedRig]] = {
    "telegram 1": speed,
    "telegram 2": lambda: speed(2),
    "telegram 9": positioning,
    "telegram 100": transparent,
}


def replayed(loaded: Loaded) -> tuple[int, list[tuple[str, tuple[str, ...]]]]:
    """Steps compared, and what differs."""
    (outcome,) = loaded.replay(first_only=True)
    return outcome.compared, [(item.what, item.names) for item in outcome.differences]


@pytest.mark.parametrize("name", RIGS)
@pytest.mark.parametrize("jitter_ms", [0, 2])
def test_an_unmodified_recording_is_equal(name: str, jitter_ms: int, tmp_path: Path) -> None:
    rig = RIGS[name]()
    loaded = rig.load(tmp_path, jitter_ns=jitter_ms * MS)
    compared, differences = replayed(loaded)
    assert not differences
    assert compared >= len(rig.frames.plc) - 2


@pytest.mark.parametrize("name", RIGS)
def test_every_changed_controlword_is_found(name: str, tmp_path: Path) -> None:
    rig = RIGS[name]()
    rng = random.Random(name)
    count = sum(frame[1] == RPDO1 for frame in rig.frames.can)
    place = 2 * list(RIGS).index(name)
    for bit in (1 << place, 2 << place):  # each bit of the low byte in one of the telegrams
        before = list(rig.frames.can)
        number = rng.randrange(1, count - 1)
        time_ns = rig.frames.change_can(
            RPDO1, number, lambda data, bit=bit: data[:-2] + bytes((data[-2] ^ bit, data[-1]))
        )
        loaded = rig.load(tmp_path, 0)
        (outcome,) = loaded.replay(first_only=True)
        (difference,) = outcome.differences
        # An ON may have waited for its confirmation: then the first thing that fits no choice can be the answer beside it.
        assert "Controlword" in difference.names or difference.what == "actual values"
        found_after = difference.time_ns - loaded.recording.begin_ns - (time_ns - rig.frames.plc[0][0])
        assert abs(found_after) < 40 * MS
        rig.frames.can[:] = before


def test_a_changed_target_is_named_with_its_time_and_both_values(tmp_path: Path) -> None:
    rig = speed()
    moment = rig.frames.change_can(RPDO1, 6, lambda data: (1234).to_bytes(4, "little") + data[4:])
    (outcome,) = rig.load(tmp_path, 0).replay(first_only=True)
    (difference,) = outcome.differences
    assert (difference.do_id, difference.what, difference.names) == (1, "RPDO1", ("Target Velocity",))
    assert difference.recorded == {"Controlword": 0x0F, "Target Velocity": 1234}
    assert difference.today is not None
    assert difference.today["Target Velocity"] != 1234
    assert difference.time_ns - outcome.recording.frames[0] == moment - rig.frames.plc[0][0]


def test_a_command_that_was_not_sent_is_a_difference(tmp_path: Path) -> None:
    rig = speed()
    words = [frame[2][-2] for frame in rig.frames.can if frame[1] == RPDO1]
    shutdown = [number for number, word in enumerate(words) if word == 0x06][1]
    rig.frames.change_can(RPDO1, shutdown, lambda _: None)
    assert replayed(rig.load(tmp_path, 0))[1] == [("RPDO1", ("Controlword",))]


def test_a_changed_actual_value_is_named(tmp_path: Path) -> None:
    rig = speed()
    now, frame = rig.frames.answers[50]
    rig.frames.answers[50] = (now, frame[:4] + bytes((frame[4] ^ 0x40,)) + frame[5:])
    compared, differences = replayed(rig.load(tmp_path, 0))
    assert differences == [("actual values", ("NIST_A",))]
    assert compared < 50


def test_other_sdo_values_are_a_difference(tmp_path: Path) -> None:
    rig = positioning()
    homing = bytes.fromhex("2f986000")

    def change(frame: tuple[int, int, bytes]) -> tuple[int, int, bytes]:
        now, cob_id, data = frame
        return (now, cob_id, data[:4] + b"\x11" + data[5:]) if data.startswith(homing) else frame

    rig.frames.can = [change(frame) for frame in rig.frames.can]
    assert replayed(rig.load(tmp_path, 0))[1] == [("SDO", ("Homing Method",))]


def test_a_refused_sdo_write_is_replayed_as_refused(tmp_path: Path) -> None:
    rig = RecordedRig(9)
    rig.sdo_error = "refused"
    rig.step(5)
    rig.enable()
    rig.values["SATZANW"] = 35
    rig.stw(0x0C3F, 30)
    rig.stw(0x043F, 10)
    loaded = rig.load(tmp_path, 0)
    (outcome,) = loaded.replay()
    assert not outcome.differences
    assert [event.number for step in outcome.steps for event in step.events] == [111]


def test_different_configuration_is_a_difference(tmp_path: Path) -> None:
    rig = speed()
    rig.stw(0x047E, 60)
    rig.stw(0x047F, 30)
    rig.stw(0x043F, 20)  # no setpoint: hold
    files = rig.frames.write(tmp_path)
    assert not replayed(load(files, known(1), 0, print))[1]
    other = AxisSettings(setpoint_enable=SetpointEnable.HOLD)
    assert replayed(load(files, known(1, other), 0, print))[1] == [("RPDO1", ("Target Velocity",))]


@pytest.mark.planted
def test_a_changed_gateway_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    loaded = speed().load(tmp_path, 0)
    monkeypatch.setattr("pdgw.gateway.axis.executors.speed._REACHED", 0)  # no more ZSW1.10
    assert replayed(loaded)[1] == [("actual values", ("ZSW1",))]


@pytest.mark.parametrize("name", ["telegram 1", "telegram 9"])
def test_recording_that_starts_in_operation_is_compared_from_the_next_off(name: str, tmp_path: Path) -> None:
    rig = RIGS[name]()
    rig.stw(0x043E, 120)
    rig.stw(0x043F, 20)
    without_begin(rig)
    compared, differences = replayed(rig.load(tmp_path, 0))
    assert not differences
    assert 10 < compared < len(rig.frames.plc) - 60


def without_begin(rig: RecordedRig) -> None:
    """A recording that begins in operation."""
    frames, begin = rig.frames, rig.frames.plc[40][0]
    frames.plc = [frame for frame in frames.plc if frame[0] >= begin]
    frames.answers = [frame for frame in frames.answers if frame[0] >= begin]
    frames.can = [frame for frame in frames.can if frame[0] >= begin]


def reducing_torque() -> RecordedRig:
    """A drive whose own torque limit is 150 %; the start of the recording says 300 %."""
    rig = RecordedRig(102)
    rig.step(5)
    rig.stepper.set_references(References(max_torque=1500))
    rig.enable(0x047E)
    rig.values |= {"NSOLL_B": 0x10000000, "MOMRED": 0x1000}
    rig.step(60)
    rig.stw(0x047E, 120)
    rig.stw(0x047F, 40)
    return rig


@pytest.mark.parametrize("begins_in_operation", [False, True])
def test_an_unknown_torque_limit_is_not_compared(begins_in_operation: bool, tmp_path: Path) -> None:
    rig = reducing_torque()
    if begins_in_operation:
        without_begin(rig)
    (outcome,) = rig.load(tmp_path, 0).replay(first_only=True)
    assert [item.names for item in outcome.differences] == ([] if begins_in_operation else [("Max Torque",)])
    assert outcome.not_compared == (("Max Torque",) if begins_in_operation else ())
    if begins_in_operation:
        for number in (-2, -1):
            rig.frames.change_can(RPDO1, number, lambda data: (77).to_bytes(4, "little") + data[4:])
        (outcome,) = rig.load(tmp_path, 0).replay(first_only=True)
        assert outcome.differences, "everything else is compared"
        assert all("Max Torque" not in (item.recorded or {}) for item in outcome.differences)


def test_without_answers_the_rpdos_are_compared(tmp_path: Path) -> None:
    rig = speed()
    rig.frames.answers = []
    compared, differences = replayed(rig.load(tmp_path, 0))
    assert not differences
    assert compared > 200
    rig.frames.change_can(RPDO1, 6, lambda data: (77).to_bytes(4, "little") + data[4:])
    assert replayed(rig.load(tmp_path, 0))[1] == [("RPDO1", ("Target Velocity",))]


def test_loss_of_the_plc_is_replayed(tmp_path: Path) -> None:
    rig = speed()
    rig.stw(0x047E, 60)
    rig.stw(0x047F, 40)
    rig.step(100, plc=False)
    rig.step(10)
    loaded = rig.load(tmp_path, 0)
    assert not replayed(loaded)[1]
    assert len(loaded.recording.plc.losses) == 2  # and at the end of the recording


@pytest.mark.parametrize("own", [False, True], ids=["two captures", "own recording"])
@pytest.mark.parametrize(
    ("word", "controlword"),
    [(0x047D, 0x0), (0x047B, 0x2), (0x0000, 0x0), (0x047E, 0xF)],
    ids=["OFF2", "OFF3", "zeros", "OFF1"],
)
def test_stops_of_the_plc_are_replayed_while_the_gateway_stops(
    word: int, controlword: int, own: bool, tmp_path: Path
) -> None:
    rig = stopping(word)
    loaded = in_order(rig, tmp_path) if own else rig.load(tmp_path, 0)
    (outcome,) = loaded.replay(first_only=True)
    assert not outcome.differences
    assert outcome.compared >= len(rig.frames.plc) - 2
    stopped = [step for step in outcome.steps if step.answer is not None and step.answer.plc_ok is False]
    assert {step.controlword & 0xF for step in stopped[5:8]} == {controlword}


def test_comparison_continues_at_the_next_off_after_a_difference(tmp_path: Path) -> None:
    rig = speed()
    rig.stw(0x047E, 60)
    rig.stw(0x047F, 40)
    for number in (6, -3):
        rig.frames.change_can(RPDO1, number, lambda data: (77).to_bytes(4, "little") + data[4:])
    (outcome,) = rig.load(tmp_path, 0).replay()
    assert [item.names for item in outcome.differences] in (
        [("Target Velocity",), ("Target Velocity",)],
        [("Target Velocity",), ("NIST_A",)],
        [("Target Velocity",), ("ZSW1",)],
    )
    assert len(outcome.steps) >= len(rig.frames.plc)


def test_frames_of_the_plc_become_setpoints_verdicts_and_losses() -> None:
    rig = RecordedRig(1)
    rig.stw(0x047E, 3)
    frames = list(rig.frames.plc)
    stopped = bytearray(frames[2][1])
    TRAILER.pack_into(stopped, len(stopped) - 4, 999, STATUS_STOP, 0)
    now = frames[2][0]
    late = now + 100 * MS
    given = [*frames, (now + MS, frames[1][1]), (now + 2 * MS, bytes(stopped)), (late, frames[0][1])]
    inputs = receive_frames([Frame(at, data, at) for at, data in given], [telegram(1)], cycle_ns=CYCLE_NS)
    assert [item.verdict for item in inputs.received[3:]] == [
        Verdict.STALE,
        Verdict.PROVIDER_STOP,
        Verdict.ACCEPTED,
    ]
    assert inputs.losses == [now + 2 * MS + 3 * CYCLE_NS + 1, late + 3 * CYCLE_NS + 1]
    assert [event.values for event in inputs.setpoints[0]] == [(0x047E, 0), None, (0x047E, 0), None]


def values_of(command: DriveCommand) -> list[int]:
    return [getattr(command, name) for name in attributes(command)]


@pytest.mark.parametrize("number", DRIVE_TELEGRAM_NUMBERS)
def test_machine_returns_to_its_checkpoint(number: int) -> None:
    rng = random.Random(number)
    stepper = Stepper(number)
    stepper.set_references(References())
    stepper.step(None, DriveFeedback(), False, 0)
    half = stepper.telegram.setpoints
    drive = PlainDrive()

    def inputs() -> tuple[tuple[int, ...], DriveFeedback]:
        words = (0x047E, 0x047F, 0x043F, 0x0C3F, 0x04FE, 0x045F, 0x0000, 15)
        values = [rng.choice(words), *(rng.choice((0, 0x8023, 1, 5)) for _ in half.signals[1:])]
        drive.step(stepper.command)
        return tuple(values), drive.feedback

    for now in range(0, 300 * CYCLE_NS, CYCLE_NS):
        values, feedback = inputs()
        checkpoint, print_before = stepper.checkpoints.save(), stepper.checkpoints.fingerprint()
        first = tuple(stepper.step(values, feedback, True, now)), values_of(stepper.command)
        after = stepper.checkpoints.fingerprint()
        stepper.checkpoints.restore(checkpoint)
        assert stepper.checkpoints.fingerprint() == print_before
        assert (tuple(stepper.step(values, feedback, True, now)), values_of(stepper.command)) == first
        assert stepper.checkpoints.fingerprint() == after


def in_order(rig: RecordedRig, folder: Path) -> Loaded:
    """The gateway's own recording."""
    return load(rig.frames.write_in_order(folder), rig.known, None, lambda _: None)


def test_an_sdo_that_is_answered_before_the_next_step_is_answered_in_it(tmp_path: Path) -> None:
    rig = positioning(sdo_delay=1)
    compared, differences = replayed(in_order(rig, tmp_path))
    assert not differences
    assert compared > 200


def test_no_step_is_replayed_in_a_silence_without_steps(tmp_path: Path) -> None:
    rig = RecordedRig(2)
    rig.step(5)
    rig.enable(0x047E)
    for cycle in range(60):
        rig.values["STW2"] = (cycle % 15 + 1) << 12
        if cycle % 10 == 9:
            rig.pause(3)  # the frame is late, and a cycle without one would be due before it
        rig.step()
    assert rig.actuals["ZSW2"] >> 12 == 15, "one for each frame"
    compared, differences = replayed(in_order(rig, tmp_path))
    assert not differences
    assert compared > 60


def test_position_errors_that_are_the_same_in_many_frames_are_not_old(tmp_path: Path) -> None:
    rig = RecordedRig(105, dsc=DscChoices(DscForm.SPEED, following_window=4096))
    rig.step(5)
    rig.enable(0x040E)
    rig.values |= {"KPC": 20_000, "XERR": 40}
    rig.step(60)
    assert rig.stepper.reason is None
    compared, differences = replayed(in_order(rig, tmp_path))
    assert not differences
    assert compared > 60


def test_checkpoint_restores_parts_created_for_the_drive() -> None:
    rig = Rig(105, dsc=DscChoices(DscForm.POSITION, following_window=4096))
    rig.stepper.set_references(References())
    rig.enable(0x040E)
    stepper, half = rig.stepper, rig.stepper.telegram.setpoints

    def goes_on() -> list[list[int]]:
        commands = []
        for cycle in range(1, 5):
            following = half.from_dict(rig.values | {"KPC": 20_000, "XERR": 40 * cycle})
            for fresh in (True, False):
                stepper.step(following, rig.feedback, True, rig.now + cycle * CYCLE_NS, fresh=fresh)
                commands.append(values_of(stepper.command))
        return commands

    checkpoint = stepper.checkpoints.save()
    first = goes_on()
    assert len(set(map(tuple, first))) > 4
    stepper.checkpoints.restore(checkpoint)
    assert goes_on() == first


def test_empty_recording_has_no_steps() -> None:
    outcome = Replayer(AxisRecording(1, NODE, telegram(1)), cycle_ns=CYCLE_NS, tolerance_ns=20 * MS).run()
    assert (outcome.steps, outcome.differences) == ([], [])


class Stalled(RecordedRig):
    """A gateway with pauses: frames that arrive meanwhile are queued and processed together."""

    def __init__(self, watchdog_factor: int = 100) -> None:
        self.watchdog_factor = watchdog_factor
        self.held: list[tuple[int, bytes]] | None = None
        self.waited: dict[bytes, int] = {}
        """How long frames of the PLC waited."""
        super().__init__(1)
        self.endpoint = CyclicEndpoint([telegram(1)], cycle_ns=CYCLE_NS, watchdog_factor=watchdog_factor)

    def _transmitted(self, can_id: int, data: bytes) -> None:
        if self.held is None:
            super()._transmitted(can_id, data)
        else:
            self.held.append((can_id, bytes(data)))

    def stand_still(self, cycles: int, *, before_answer: bool = False) -> None:
        """``before_answer``: between the last frame and its answer."""
        self.held, begin = [], self.now
        self.plc.set(0, self.values)
        frames = []
        for cycle in range(1, cycles + 1):
            self._advance(4)
            frames.append((begin + cycle * CYCLE_NS, bytes(self.plc.build())))
        held, self.held = self.held, None
        if before_answer:
            _, answer = self.frames.answers.pop()
            self.frames.answers.append((self.now - 1, answer))
        for can_id, data in held:
            self._transmitted(can_id, data)
        for came, frame in frames:
            self.frames.plc.append((self.now, frame))
            self.waited[frame] = self.now - came
            self.endpoint.receive(frame, ("127.0.0.1", 34962), self.now, came)
        self.step()

    def own_recording(self, folder: Path) -> Loaded:
        """The gateway's own recording."""
        watchdog = replace(self.known, watchdog_factor=self.watchdog_factor)
        return load(self.frames.write_in_order(folder, self.waited), watchdog, None, lambda _: None)


@pytest.mark.parametrize(("cycles", "watchdog_factor"), [(3, 100), (40, 100), (75, 100), (125, 100), (310, 300)])
def test_gateway_recording_keeps_its_order_after_a_long_pause(
    cycles: int, watchdog_factor: int, tmp_path: Path
) -> None:
    rig = Stalled(watchdog_factor)
    rig.step(5)
    rig.enable(0x047E)
    for speed_asked in (0x1000, 0x3000, 0x0800):
        rig.values["NSOLL_A"] = speed_asked
        rig.step(20)
        rig.stand_still(cycles)
        rig.step(20)
    rig.stw(0x047E)
    rig.stand_still(cycles)
    rig.step(100)
    compared, differences = replayed(rig.own_recording(tmp_path))
    assert not differences
    assert compared > 200


def test_paused_gateway_detects_the_loss_after_the_queued_frames(tmp_path: Path) -> None:
    rig = Stalled()
    rig.step(5)
    rig.enable(0x047E)
    rig.step(20)
    rig.stand_still(150, before_answer=True)
    answered = rig.frames.answers[-2][0] - rig.frames.plc[0][0]
    rig.step(100)
    assert rig.endpoint.watchdog_expiries == 1
    loaded = rig.own_recording(tmp_path)
    lost = loaded.recording.plc.losses[0] - loaded.recording.begin_ns
    assert answered < lost < answered + MS
    compared, differences = replayed(loaded)
    assert not differences
    assert compared > 100


@pytest.mark.parametrize("later_ms", [0, 2500])
def test_step_in_time_may_be_answered_after_the_watchdog_expired(later_ms: int, tmp_path: Path) -> None:
    rig = Stalled()
    rig.step(5)
    rig.enable(0x047E)
    rig.step(20)
    rig.step(100, plc=False)
    rig.pause(later_ms)
    _, answer = rig.frames.answers.pop()
    rig.frames.answers.append((rig.now + MS, answer))
    rig.step(50, plc=False)
    loaded = rig.own_recording(tmp_path)
    last_in_time = max(answer.time_ns for answer in loaded.recording.axes[0].answers if answer.plc_ok)
    assert last_in_time > loaded.recording.plc.losses[0]
    compared, differences = replayed(loaded)
    assert not differences
    assert compared > 100
