"""Each bit gives the reasons of its rows, and texts and remedies name those bits alone that give a reason now."""

from __future__ import annotations

import re
from itertools import combinations

import pytest

from pdgw.dsp402.objects import NEGATIVE_LIMIT_SWITCH, POSITIVE_LIMIT_SWITCH
from pdgw.dsp402.states import StatusBit
from pdgw.gateway.base.reasons import AxisState, Finding, Reason
from pdgw.gateway.base.steps import OFF_ON, Bits
from pdgw.gateway.objects.bit_effects import BIT_EFFECTS, BitEffect, bit_effects
from pdgw.peers.drive.model.model import DriveModel
from pdgw.profidrive.signals import signal
from tests.support.documents.device_situations import MDI, POSITIONER
from tests.support.documents.origin_situations import show_local
from tests.support.documents.situations import clear_bits, in_operation, run_out
from tests.support.gateways.daemon import OFF, ON, axis, drive_of, operating

_SETPOINT = [row.bit for row in BIT_EFFECTS if Reason.SETPOINT_DISABLED in row.reasons]
_ENABLES = [row.bit for row in BIT_EFFECTS if Reason.HELD_OFF in row.reasons]


def named(text: str) -> set[int]:
    """The bits of STW1 that a text names beside ON."""
    return {int(bit) for bit in re.findall(r"STW1\.(\d+)", text)} - {0}


def test_the_bits_of_the_table_are_those_of_their_words() -> None:
    shown = {
        ("Statusword", 1 << 9): StatusBit.REMOTE,
        ("60FDh", 1 << 0): NEGATIVE_LIMIT_SWITCH,
        ("60FDh", 1 << 1): POSITIVE_LIMIT_SWITCH,
    }
    for row in BIT_EFFECTS:
        if "STW1" not in row.words:
            assert shown[row.words[0], 1 << row.bit] == 1 << row.bit
        else:
            assert row.bit in {bit.position for bit in signal(row.words[0]).fields(positioning=True)}
            assert row.level == 0


@pytest.mark.parametrize(
    "row",
    [row for row in BIT_EFFECTS if "STW1" in row.words],
    ids=lambda row: f"STW1.{row.bit}-{row.reasons[0].name}",
)
def test_a_bit_of_stw1_that_is_0_gives_a_reason_of_its_row(row: BitEffect) -> None:
    positions = row.reasons[0] is Reason.REJECTED
    with in_operation(POSITIONER if positions else axis(1)) as (daemon, plc):
        if positions:
            plc.endpoint.set(0, MDI | {"STW1": 0x043F, "MDI_TARPOS": 900_000})
            plc.exchange(10)
            plc.endpoint.set(0, {"STW1": 0x047F})
            plc.exchange(10)
        clear_bits(plc, 1 << row.bit)
        seen = set()
        for _ in range(200):
            plc.exchange()
            link = daemon.axes[0].enable_status.broken
            seen |= {daemon.axes[0].reason, None if link is None else link.reason}
            if link is not None and link.reason in row.reasons:
                assert f"set STW1.{row.bit} = 1" in link.todo
        assert seen & set(row.reasons)


@pytest.mark.parametrize("bits", [bits for n in (1, 2, 3) for bits in combinations(_SETPOINT, n)], ids=str)
def test_a_missing_setpoint_names_the_bits_that_are_0_alone(bits: tuple[int, ...]) -> None:
    with in_operation() as (daemon, plc):
        clear_bits(plc, sum(1 << bit for bit in bits))
        run_out(plc)
        link = daemon.axes[0].enable_status.broken
        assert link is not None
        assert named(link.evidence) == named(link.todo) == set(bits)


@pytest.mark.parametrize("bits", [bits for n in (1, 2, 3) for bits in combinations(_ENABLES, n)], ids=str)
def test_a_drive_held_off_names_the_bits_that_are_0_alone(bits: tuple[int, ...]) -> None:
    with in_operation() as (daemon, plc):
        clear_bits(plc, sum(1 << bit for bit in bits))
        run_out(plc)
        link = daemon.axes[0].enable_status.broken
        assert link is not None
        assert named(link.evidence) == named(link.todo) == set(bits)


@pytest.mark.parametrize("bits", [(1,), (2,), (1, 2)], ids=str)
def test_a_drive_that_is_off_names_the_bits_of_its_stop_alone(bits: tuple[int, ...]) -> None:
    with in_operation() as (daemon, plc):
        clear_bits(plc, 1 | sum(1 << bit for bit in bits))
        run_out(plc)
        link = daemon.axes[0].enable_status.broken
        assert link is not None
        assert link.reason in (Reason.COAST_STOP, Reason.QUICK_STOP)
        assert named(link.todo) == set(bits)


@pytest.mark.parametrize(
    ("word", "bit"), [(0x052F, 8), (0x062F, 9), (0x0C2F, 11), (0x046F, 6)], ids=["jog 1", "jog 2", "homing", "task"]
)
@pytest.mark.parametrize("number", [7, 110, 111])
def test_what_is_asked_while_tasks_are_rejected_names_its_own_bit(number: int, word: int, bit: int) -> None:
    with in_operation(POSITIONER.replace("telegram = 111", f"telegram = {number}")) as (daemon, plc):
        for sent in (0x043F, 0x042F, word):
            plc.endpoint.set(0, {"STW1": sent})
            plc.exchange(20)
        link = daemon.axes[0].enable_status.broken
        assert link is not None
        assert link.todo == f"the PLC's program must set STW1.4 = 1, and then a new edge of STW1.{bit}"
        assert named(link.evidence) == {4, bit}


@pytest.mark.parametrize("homing_method", ["homing_method = 35\n", ""], ids=["during a jog", "without a method"])
def test_a_homing_order_that_is_withdrawn_leaves_no_reason(homing_method: str) -> None:
    jog = 0x100 if homing_method else 0
    with in_operation(POSITIONER.replace("homing_method = 35\n", homing_method)) as (daemon, plc):
        for word in (0x043F, 0x043F | jog, 0x0C3F | jog):
            plc.endpoint.set(0, {"STW1": word})
            plc.exchange(20)
        assert daemon.axes[0].reason in (Reason.FUNCTION_RUNS, Reason.HOMING_METHOD)
        plc.endpoint.set(0, {"STW1": 0x043F | jog})
        plc.exchange(20)
        assert daemon.axes[0].enable_status.state is AxisState.OBEYS
        assert daemon.axes[0].enable_status.broken is None


@pytest.mark.parametrize("turns", ["by the PLC", "by the panel", "off"])
def test_local_mode_is_a_fault_only_of_a_shaft_that_the_plc_does_not_turn(turns: str) -> None:
    def panel(model: DriveModel, _: int) -> None:
        model.velocity_actual = 500

    with in_operation() as (daemon, plc):
        model = drive_of(daemon).model
        plc.endpoint.set(0, {"NSOLL_A": 0x1000 if turns == "by the PLC" else 0, "STW1": OFF if turns == "off" else ON})
        run_out(plc)
        show_local(plc, daemon)
        if turns != "by the PLC":
            model.disguises.append(panel)
        plc.exchange(5)  # before its speed contradicts its position
        link, state = daemon.axes[0].enable_status.broken, daemon.axes[0].enable_status.state
        assert daemon.axes[0].turns
        assert link is not None
        if turns != "by the PLC":
            assert (link.reason, state) == (Reason.LOCAL_TURNS, AxisState.FAULT)
            return
        assert (link.reason, state) == (Reason.LOCAL_MODE, AxisState.OBEYS)
        model.disguises.clear()
        run_out(plc)
        assert daemon.axes[0].enable_status.broken is None


def test_a_drive_that_shows_remote_with_power_alone_is_never_in_local_mode() -> None:
    with operating(before=lambda daemon: drive_of(daemon).node.start_fault("no-remote-bit-when-off")) as (daemon, plc):
        plc.endpoint.set(0, {"NSOLL_A": 0x4000})
        run_out(plc)
        for word in (0x047B, OFF, ON, 0x047D, OFF, ON):  # OFF3 and OFF2 of a turning axis
            plc.endpoint.set(0, {"STW1": word})
            for _ in range(150):
                plc.exchange()
                assert "(local mode)" not in daemon.axes[0].enable_status.sentence
        assert daemon.axes[0].enable_status.state is AxisState.OBEYS


def test_bits_that_give_a_reason_are_one_equation() -> None:
    words = {"STW1": 0x0405}
    assert bit_effects(Reason.HELD_OFF, words) == Finding(
        Reason.HELD_OFF,
        "the PLC sends ON (STW1.0 = 1) and keeps the drive off: STW1.1 = STW1.3 = 0 (OFF2, Disable Operation)",
        (Bits(("STW1.1", "STW1.3")), OFF_ON),
    )
    assert "off: Controlword.1 = Controlword.2 = 0" in bit_effects(Reason.HELD_OFF, {"Controlword": 0x9}).evidence
    assert bit_effects(Reason.COAST_STOP, {"STW1": 0xFFFF}) == Finding.of(Reason.COAST_STOP)
    assert bit_effects(Reason.STOPPED_AT_LIMIT, {"60FDh": 0x2}) == Finding(
        Reason.STOPPED_AT_LIMIT,
        "stopped at a limit of the drive (Statusword.11): 60FDh.1 = 1 (positive limit switch)",
        Reason.STOPPED_AT_LIMIT.remedy,
    )
