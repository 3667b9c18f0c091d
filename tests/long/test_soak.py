"""Random lives in virtual time: a short campaign, what is drawn, and the command."""

from __future__ import annotations

import gc
import hashlib
import re
import weakref
from contextlib import nullcontext
from itertools import combinations_with_replacement, islice
from random import Random

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.loop.virtual_loop import VirtualLoop
from pdgw.dsp402.states import State
from pdgw.gateway.axis.settings import ControlLost, PlcLossReaction
from pdgw.gateway.axis.telegrams import DRIVE_TELEGRAM_NUMBERS
from pdgw.gateway.base.udp import Address
from pdgw.peers.drive import SHAPES
from pdgw.peers.world import Conditions
from pdgw.profidrive.frame import CSduLayout
from pdgw.profidrive.telegrams import Direction, telegram
from tests.long.rules import Rule, Seen, broken
from tests.long.soak.__main__ import main
from tests.long.soak.disturbances import DISTURBANCES, UNPLUGGED
from tests.long.soak.plan import CYCLES_MS, PART_CYCLES, SHORTEST_PART_NS, draw_plan, parts, shapes_of
from tests.long.soak.planted import DEFECTS
from tests.long.soak.soak_run import SoakRun
from tests.long.soak.trace import clock
from tests.long.soak.watch import SoakAxis, ViolationError
from tests.long.soak.words import Words

NOT_DRAWN = {"slow-sdo", "slow-boot", "unguarded", "csp", "endless", "range-limit"}
"""Shapes that need minutes to come online, and two that the gateway refuses."""
BY_NAME = {disturbance.name: disturbance for disturbance in DISTURBANCES}


def run_of(seed: int, number: int) -> SoakRun:
    """A run of one axis that keeps its telegram."""
    return SoakRun(next(parts(seed, 1, [number])), keep_telegrams=True)


@pytest.mark.parametrize("seed", range(2))
def test_short_soak_of_drawn_axes_finds_nothing(seed: int) -> None:
    soak_run = SoakRun(next(parts(seed)))
    soak_run.run_to(20 * SECOND)
    assert soak_run.starts >= 4, "a life without starts proves nothing"


@pytest.mark.parametrize("number", [9, 100, 111])
def test_short_soak_of_each_executor_finds_nothing(number: int) -> None:
    soak_run = run_of(7, number)
    soak_run.run_to(20 * SECOND)
    assert soak_run.starts >= 2


def test_one_seed_is_one_run_bit_for_bit_and_another_is_another() -> None:
    def lived(seed: int) -> tuple[list[str], str]:
        soak_run = SoakRun(next(parts(seed)), frames=True)
        everything = hashlib.sha256()
        soak_run.world.network.taps.append(
            lambda now, source, target, data: everything.update(f"{now} {source} {target} ".encode() + bytes(data))
        )
        soak_run.bus.taps.append(
            lambda now, member, can_id, data: everything.update(f"{now} {can_id} ".encode() + data)
        )
        soak_run.run_to(4 * SECOND)
        return soak_run.trace.lines, everything.hexdigest()

    assert lived(3) == lived(3) != lived(4)


def test_part_of_the_day_runs_without_those_before_it() -> None:
    part = next(islice(parts(1), 2, None))
    soak_run = SoakRun(part)
    soak_run.run_to(part.begin + 10 * SECOND)
    assert soak_run.loop.now() == part.begin + 10 * SECOND
    assert soak_run.trace.lines[0].startswith(clock(part.begin)[:6])


def test_parts_follow_each_other_with_as_many_cycles_each() -> None:
    day = list(islice(parts(1), 100))
    assert [part.begin for part in day] == [0, *(part.end for part in day[:-1])]
    cycles = {part.plan.duration_ns // (part.plan.cycle_ms * MS) for part in day}
    assert min(cycles) == PART_CYCLES
    assert min(part.plan.duration_ns for part in day) == SHORTEST_PART_NS


def test_every_disturbance_begins_and_ends() -> None:
    """Drawn by weight: each has its turn within minutes; here they begin one after the other."""
    soak_run = run_of(11, 1)
    soak_run.run_to(5 * SECOND)
    for disturbance in DISTURBANCES:
        undo = disturbance.begin(soak_run, soak_run.axes[0], Random(1))
        soak_run.run_to(soak_run.loop.now() + SECOND // 10)
        undo()
    assert BY_NAME.keys() >= {"PLC: IOPS BAD", "bus: other master", "network: second PLC"}


def test_gateway_that_ended_starts_again_when_interface_is_plugged_in() -> None:
    soak_run = run_of(11, 1)
    soak_run.run_to(SECOND)
    soak_run.begin_disturbance(BY_NAME["bus: other master"], soak_run.axes[0], MS)
    ended = soak_run.daemon
    while not ended.stopped.is_set():
        soak_run.run_to(soak_run.loop.now() + MS // 5)
    soak_run.begin_disturbance(BY_NAME[UNPLUGGED], soak_run.axes[0], SECOND)
    soak_run.run_to(soak_run.loop.now() + SECOND // 2)
    assert soak_run.daemon is ended
    soak_run.run_to(soak_run.loop.now() + SECOND)
    assert soak_run.daemon is not ended


def test_gateway_that_starts_again_has_the_drives_own_torque_limit_of_the_one_before() -> None:
    soak_run = run_of(11, 102)
    soak_run.run_to(5 * SECOND)
    axis, before = soak_run.axes[0], soak_run.daemon
    kept = before.store.parameters.drive_object(1).own_values
    assert [item.index for item in kept.values] == [0x6072]
    axis.drive.node.model.max_torque = 1
    soak_run.begin_disturbance(BY_NAME["bus: other master"], axis, MS)
    while soak_run.daemon is before or not soak_run.daemon.clients[0].generation:
        soak_run.run_to(soak_run.loop.now() + MS)
    drive = soak_run.daemon.axes[0].drive.drive_type
    assert drive is not None
    assert drive.max_torque == kept.values[0].value


@pytest.mark.parametrize("delay_ms", [100, 250], ids=["counter old", "counter as if new"])
@pytest.mark.parametrize(("place", "value"), [("iops", 0), ("STW1", 0x7D)], ids=["IOPS BAD", "OFF2"])
def test_overtaken_frame_is_not_a_reason_for_another_off(
    delay_ms: int, place: str, value: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The gateway drops it. By the rule of PROFINET a counter counts as new again when it is more than 128 ms old."""
    soak_run = run_of(7, 1)
    network, layout = soak_run.world.network, CSduLayout([telegram(1)], Direction.SETPOINT)
    frames: list[tuple[Address, Address, bytes]] = []
    network.arrivals.append(lambda _, source, target, data: frames.append((source, target, data)))
    soak_run.run_to(2 * SECOND)
    reasons: list[str] = []
    monkeypatch.setattr(SoakAxis, "require_new_off", lambda self, why, since=None: reasons.append(why))
    source, target, data = [frame for frame in frames if frame[1] == soak_run.daemon.address][-1]
    late = bytearray(data)
    late[layout.iops[0] if place == "iops" else layout.offsets[0] + 1] = value
    network.conditions = Conditions(delay_ns=delay_ms * MS)
    network.carry(bytes(late), source, target)
    network.conditions = Conditions()
    soak_run.run_to(soak_run.loop.now() + 300 * MS)
    assert bytes(late) in [frame[2] for frame in frames]
    assert reasons == []


def test_enable_operation_repeated_although_drive_left_operation_is_a_new_command() -> None:
    """The first word after the time in which the gateway can have reacted, while the drive is lost."""
    axis, loop = _left_operation_in_a_ramp()
    axis.check(loop.now(), reached=False, zsw1=None)
    loop.run_for(axis.reaction_ns + axis.late_ns)
    axis.commanded(loop.now(), 0xF)
    with pytest.raises(ViolationError, match="provider STOP"):
        axis._entered(State.OPERATION_ENABLED)


def _left_operation_in_a_ramp() -> tuple[SoakAxis, VirtualLoop]:
    """Enable Operation was sent in a ramp after a provider STOP; then the drive left operation by its enable input."""
    soak_run = run_of(7, 1)
    axis, loop = soak_run.axes[0], soak_run.loop
    axis.drive.model.watchers.clear()
    axis.asked(loop.now(), bytes([0x04, 0x7F, 0, 0]), certain=True)
    axis.commanded(loop.now(), 0xF)
    axis._entered(State.OPERATION_ENABLED)
    loop.run_for(MS)
    axis.require_new_off("provider STOP")
    loop.run_for(MS)
    axis.commanded(loop.now(), 0xF)
    loop.run_for(MS)
    axis._entered(State.SWITCHED_ON)
    loop.run_for(MS)
    return axis, loop


_IN_TIME, _LATE = MS, SECOND


@pytest.mark.parametrize(
    ("words", "after", "reached", "rejected"),
    [
        ([], _IN_TIME, True, False),
        ([], _LATE, True, True),
        ([], _LATE, False, False),
        ([0xF], _IN_TIME, True, False),
        ([0xF], _LATE, True, True),
        ([0x7], _LATE, True, False),
        ([0x7, 0xF], _IN_TIME, True, True),
        ([0x7, 0xF], _LATE, False, True),
    ],
    ids=["nothing yet", "nothing", "drive lost", "repeated", "repeated, late", "taken back", "new", "new, drive lost"],
)
def test_start_after_loss_counts_when_gateway_enables_or_does_not_withdraw_it(
    words: list[int], after: int, reached: bool, rejected: bool
) -> None:
    """The input is back: by an Enable Operation from before, also repeated since, the drive may start only until the gateway
    can have reacted.
    """
    axis, loop = _left_operation_in_a_ramp()
    for word in words:
        axis.commanded(loop.now(), word)
    if not reached:
        axis.check(loop.now(), reached=False, zsw1=None)
    loop.run_for(after)
    with pytest.raises(ViolationError, match="provider STOP") if rejected else nullcontext():
        axis._entered(State.OPERATION_ENABLED)


@pytest.mark.parametrize(
    ("enabled_ms", "started_ms", "rejected"),
    [(100, 9_990, False), (100, 9_970, True), (5_000, 9_990, True), (100, 200, True)],
    ids=["held frame", "no stop behind it", "sent long after the loss", "not stopped at all"],
)
def test_drive_turns_after_loss_only_until_stop_after_held_frame(
    enabled_ms: int, started_ms: int, rejected: bool
) -> None:
    """Times since the loss, checked after 10 s: the controller sent an Enable Operation late, and the stop after it."""
    soak_run = run_of(7, 1)
    (axis,), loop = soak_run.axes, soak_run.loop
    model = axis.drive.model
    model.watchers.clear()
    lost = loop.now()
    axis.check(lost, reached=False, zsw1=None)
    loop.run_for(enabled_ms * MS)
    for stw1 in (0x047E, 0x047F):
        axis.asked(loop.now(), stw1.to_bytes(2, "big") + bytes(2), certain=True)
    axis.commanded(loop.now(), 0xF)
    loop.run_for((started_ms - enabled_ms) * MS)
    axis._entered(State.OPERATION_ENABLED)
    loop.run_for((10_000 - started_ms) * MS)
    model.state, model.ramp.speed = State.OPERATION_ENABLED, 9.0
    axis._see_loss(loop.now(), seen := Seen())
    assert (Rule.STOPS in broken(seen)) is rejected


def test_rpdo_to_drive_after_power_on_is_not_a_controlword() -> None:
    """The drive has its own mapping then, and takes no RPDO."""
    soak_run = run_of(7, 9)
    soak_run.run_to(2 * SECOND)
    (axis,) = soak_run.axes
    rpdos = axis.drive.node.pdos.received.items()
    can_id, frame = next((i, pdo.pack(axis.drive.model)) for i, pdo in rpdos if "controlword" in pdo.attributes)
    assert axis.controlword_in(can_id, frame) == axis.drive.model.controlword
    axis.drive.do(lambda node: node.power_off())
    axis.drive.do(lambda node: node.restart())
    assert axis.controlword_in(can_id, frame) is None


# -- what is drawn ----------------------------------------------------------------------------------------------------------


def test_parts_draw_every_setting_there_is() -> None:
    plans = [draw_plan(Random(f"part {part}"), 2) for part in range(1500)]
    axes = [axis for plan in plans for axis in plan.axes]
    assert {plan.cycle_ms for plan in plans} == set(CYCLES_MS) == set(range(1, 33))
    assert {axis.telegram for axis in axes} == set(DRIVE_TELEGRAM_NUMBERS) - {112}, "floats come with P922 only"
    assert {axis.shape for axis in axes} == set(SHAPES) - NOT_DRAWN
    assert {axis.on_plc_loss for axis in axes} == set(PlcLossReaction)
    assert {axis.control_lost for axis in axes} == set(ControlLost)
    for ends in zip(*((axis.latency.command_ms, axis.latency.status_ms) for axis in axes), strict=True):
        assert {min(ends), max(ends)} == {0, 100}


class _ShortestCycle(Random):
    """Draws the first of each sequence."""

    def choice(self, seq):  # type: ignore[no-untyped-def]
        return seq[0]


def test_gateway_accepts_every_pair_of_telegrams_at_each_drawn_cycle() -> None:
    pairs = combinations_with_replacement(DRIVE_TELEGRAM_NUMBERS, 2)
    plans = [draw_plan(_ShortestCycle(0), 2, pair) for pair in pairs]
    assert {plan.cycle_ms for plan in plans} == {1, 2}, "2 ms for two axes with DSC"
    for plan in plans:
        axes = plan.configuration("bus", "192.168.0.10", "192.168.0.20").axis
        assert [axis.telegram for axis in axes] == [axis.telegram for axis in plan.axes]
        assert all(set(axis.telegrams) == set(DRIVE_TELEGRAM_NUMBERS) for axis in axes)
        assert all(axis.shape in shapes_of(axis.telegram) for axis in plan.axes)


def test_control_words_last_one_frame_up_to_seconds() -> None:
    words = Words(telegram(1), Random(1), 4 * MS)
    stands = [words.word_duration_ns() for _ in range(2000)]
    assert min(stands) == 4 * MS
    assert sum(stand <= 250 * MS for stand in stands) > 1500
    assert max(stands) > SECOND


# -- the command ------------------------------------------------------------------------------------------------------------


def test_command_prints_what_was_run_and_its_speed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--hours", "0.005", "--seed", "4", "--axes", "2", "--telegrams", "1,9"]) == 0
    assert re.search(r"^\| 1,9 \| 0.005 \| \d+ \| 0 \| \d+ \| \d+ \|$", capsys.readouterr().out, re.MULTILINE)


@pytest.mark.planted
def test_failure_names_the_command_that_shows_its_moment(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.MonkeyPatch.context() as patch:
        DEFECTS["the drive gets twice the speed"](patch)
        assert main(["--hours", "0.01", "--seed", "25", "--axes", "1", "--telegrams", "1"]) == 1
        failed = capsys.readouterr().out
        again = re.search(r"python -m tests.long.soak (--seed 25 --axes 1 --telegrams 1 --until [\d.]+)\n", failed)
        assert again, failed
        assert main(again[1].split()) == 1
    shown = capsys.readouterr().out
    assert "CAN gateway: 77Fh 05" in shown
    assert re.findall(r"^\d\d:\d\d:\d\d\.\d{6} axis 1: .*", failed, re.MULTILINE)[-1] in shown


def test_command_replays_what_the_gateways_recorded(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--hours", "0.005", "--seed", "3", "--axes", "1", "--telegrams", "9", "--replay"]) == 0
    assert re.search(r"^\d{4,} steps replayed without a difference$", capsys.readouterr().out, re.MULTILINE)


def test_steps_after_another_mapping_are_replayed(capsys: pytest.CaptureFixture[str]) -> None:
    """The first RPDO of a drive whose mapping is new, at 163.044 s."""
    assert main(["--until", "163.1", "--seed", "611", "--axes", "1", "--telegrams", "111", "--replay"]) == 0
    assert "replayed without a difference" in capsys.readouterr().out


def test_wrong_telegrams_are_rejected(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--telegrams", "1,x"])
    assert "expected numbers with commas between" in capsys.readouterr().err


def test_nothing_of_a_part_is_left_after_it() -> None:
    """A day is many parts: what one keeps is a leak."""
    soak_run = SoakRun(next(parts(1)))
    soak_run.run_to(5 * SECOND)
    world = weakref.ref(soak_run.world)
    soak_run.close()
    del soak_run
    gc.collect()
    assert world() is None
