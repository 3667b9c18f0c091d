"""Remedies that are enough: a program that does what the sentence says, and nothing else, has what it asked for."""

from __future__ import annotations

import pytest

from pdgw.dsp402.states import STATUS_OF, State, StatusBit, state_of
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.peers.drive.model.model import DriveModel
from tests.support.documents.device_situations import MDI, POSITIONER
from tests.support.documents.situations import SLOW_PLC, in_operation, run_out, show_no_supply, trip
from tests.support.gateways.daemon import Plc, axis, configuration, drive_of, encoder_of, running

_NINE = {"SATZANW": 0x8023, "MDI_VELOCITY": 0x2000_0000, "MDI_ACC": 0x2000, "MDI_DEC": 0x2000, "MDI_MOD": 1}
_BLOCK = "[[axis.block]]\nnumber = 1\nposition = 60_000\nvelocity = 12_000\n"
_REFUSED = {
    "speed 0": (111, {"MDI_VELOCITY": 0}, {"MDI_VELOCITY": 12_000}, Reason.TASK_SPEED_ZERO),
    "deceleration 0": (111, {"MDI_DEC": 0}, {"MDI_DEC": 0x4000}, Reason.TASK_RAMP_ZERO),
    "block 9": (111, {"POS_STW1": 9}, {"POS_STW1": 1}, Reason.TASK_BLOCK_UNKNOWN),
    "no direction": (111, {"POS_STW1": 0xC000}, {"POS_STW1": 0xC200}, Reason.TASK_DIRECTION),
    "target": (111, {"MDI_TARPOS": 2_000_000}, {"MDI_TARPOS": 50_000}, Reason.TASK_DRIVE_RANGE),
    "telegram 9, speed 0": (9, {"MDI_VELOCITY": 0}, {"MDI_VELOCITY": 0x2000_0000}, Reason.TASK_SPEED_ZERO),
    "telegram 9, ramp 0": (9, {"MDI_ACC": 0}, {"MDI_ACC": 0x2000}, Reason.TASK_RAMP_ZERO),
}


def texts(daemon: Daemon) -> tuple[Reason | None, str, str]:
    """Reason, evidence and remedy of the first axis."""
    link = daemon.axes[0].enable_status.broken
    return (None, "", "") if link is None else (link.reason, link.evidence, link.todo)


def send(plc: Plc, word: int, cycles: int = 20, **values: int) -> None:
    """The PLC sends STW1 and other words."""
    plc.endpoint.set(0, {"STW1": word, **values})
    plc.exchange(cycles)


def test_remedy_of_mdi_in_telegram_7_deselects_it() -> None:
    with in_operation(POSITIONER.replace("telegram = 111", "telegram = 7") + _BLOCK) as (daemon, plc):
        send(plc, 0x043F, SATZANW=0x8001)
        send(plc, 0x047F)
        reason, evidence, remedy = texts(daemon)
        assert reason is Reason.TASK_SPEED_ZERO
        assert evidence.startswith("the task had MDI (SATZANW.15 = 1), which this telegram does not have")
        assert remedy == "set SATZANW.15 to 0, and then a new edge of STW1.6"
        send(plc, 0x043F, SATZANW=1)
        send(plc, 0x047F)
        assert texts(daemon)[0] is None


@pytest.mark.parametrize("case", _REFUSED)
def test_remedy_of_a_refused_task_ends_with_the_edge_that_starts_it(case: str) -> None:
    number, wrong, right, reason = _REFUSED[case]
    with in_operation(POSITIONER + _BLOCK if number == 111 else axis(1, telegram_number=9)) as (daemon, plc):
        send(plc, 0x043F, **((MDI | {"MDI_TARPOS": 50_000}) if number == 111 else _NINE | {"MDI_TARPOS": 1 << 27}))
        send(plc, 0x043F, **wrong)
        send(plc, 0x047F)
        found, evidence, remedy = texts(daemon)
        assert found is reason
        assert "nothing moves" not in evidence
        assert "new edge of STW1.6" in remedy
        position = plc.value("XIST_A")
        send(plc, 0x047F, 200, **right)
        assert plc.value("XIST_A") == position
        assert texts(daemon)[0] is reason
        send(plc, 0x043F)
        send(plc, 0x047F, 200)
        assert plc.value("XIST_A") != position
        assert texts(daemon)[0] is None


def test_remedy_of_a_task_names_the_bit_that_keeps_telegram_9_in_homing() -> None:
    with in_operation(axis(1, telegram_number=9)) as (daemon, plc):
        send(plc, 0x043F, **_NINE)
        send(plc, 0x0C3F, 800)
        send(plc, 0x0C7F, MDI_TARPOS=1 << 27)
        position = plc.value("XIST_A")
        _, evidence, remedy = texts(daemon)
        assert "STW1.11 = 1 (homing) at its edge" in evidence
        assert remedy == "wait for the end of the homing; set STW1.11 to 0, and then a new edge of STW1.6"
        send(plc, 0x047F)
        send(plc, 0x043F)
        send(plc, 0x047F, 800)
        assert plc.value("XIST_A") != position
        assert texts(daemon)[0] is None


@pytest.mark.parametrize("speeds", ["[-300, 300]", "[0, 300]", ""])
@pytest.mark.parametrize("bits", [0x100, 0x200, 0x300])
@pytest.mark.parametrize("turning", [False, True])
@pytest.mark.parametrize("hold", [False, True])
def test_remedy_of_a_jog_never_starts_the_speed_setpoint(speeds: str, bits: int, turning: bool, hold: bool) -> None:
    more = f"simulate = true\njog_speeds_rpm = {speeds}" if speeds else "simulate = true"
    more += '\nsetpoint_enable = "hold"' if hold else ""
    with in_operation(axis(1, more=more)) as (daemon, plc):
        if turning:
            plc.endpoint.set(0, {"NSOLL_A": 0x1000})
            plc.until(lambda: plc.value("NIST_A") == 0x1000, "the speed")
        send(plc, 0x040F | bits, 1, NSOLL_A=0x1000)
        jogs = not hold and speeds and bits != 0x300 and (bits == 0x200 or speeds[1] == "-")
        plc.exchange(3)
        reason, evidence, remedy = texts(daemon)
        if jogs and not turning:
            assert reason is None
            return
        assert not {"STW1.4", "STW1.5", "STW1.6"} & set(remedy.replace(",", " ").split())
        if jogs:
            assert reason is Reason.JOG_WAITS
            assert remedy == "wait for standstill"
            plc.until(lambda: plc.value("NIST_A") == (0x666 if bits == 0x200 else -0x666), "the jog")
            assert texts(daemon)[0] is None
        elif hold or not speeds or bits != 0x300:
            assert reason is Reason.NO_JOG_SPEED
        else:
            assert evidence == "STW1.8 or STW1.9 = 1 starts no jog: both are 1"
            run_out(plc)
            send(plc, 0x040F, 20)
            send(plc, 0x060F, 300)
            assert plc.value("NIST_A") == 0x666


@pytest.mark.parametrize("number", [1, 9, 111])
def test_acknowledge_that_came_with_control_is_named_and_its_remedy_acknowledges(number: int) -> None:
    base = 0x047E
    with in_operation(POSITIONER if number == 111 else axis(1, telegram_number=number)) as (daemon, plc):
        send(plc, base | 0x80, 2)
        trip(plc, daemon)
        send(plc, base)
        assert texts(daemon)[2].endswith("; then acknowledge (STW1.7)"), "an edge before the fault is not its own"
        for _ in range(2):
            for word in (0, base | 0x80, base):
                send(plc, word)
        assert plc.value("ZSW1") & 8
        assert texts(daemon)[2].endswith(
            "the edge of STW1.7 came with STW1.10 or before it: keep STW1.10 = 1, then set STW1.7 to 0 and then to 1"
        )
        send(plc, base)
        send(plc, base | 0x80)
        assert not plc.value("ZSW1") & 8


def test_acknowledge_of_an_encoder_that_came_with_control_is_named() -> None:
    encoder = "[[encoder]]\ndo_id = 2\nnode_id = 20\ntelegram = 81\nsimulate = true\n"
    with running(configuration(axis(1) + encoder, transport=SLOW_PLC)) as daemon:
        plc = Plc(daemon, [1, 81])
        plc.endpoint.set(1, {"STW2_ENC": 0x0400})
        plc.until(lambda: daemon.encoders[0].enable_status.broken is None, "in operation")
        encoder_of(daemon).inject("position-error")
        run_out(plc)
        encoder_of(daemon).clear()
        for word, sensor in ((0x0400, 0), (0x0400, 0x8000), (0x0400, 0), (0, 0), (0x0480, 0), (0x0400, 0)):
            plc.endpoint.set(1, {"STW2_ENC": word, "G1_STW": sensor})
            run_out(plc)
        link = daemon.encoders[0].enable_status.broken
        assert link is not None
        assert "the edge of STW2_ENC.7 came with STW2_ENC.10 or before it" in link.todo


_OFF_SUPPLY = StatusBit.VOLTAGE_ENABLED


def show_supply_above_switch_on_disabled(model: DriveModel, _: int) -> None:
    """Statusword.4 is 0 in Switch On Disabled, and 1 above it."""
    if model.statusword & 0x4F == STATUS_OF[State.SWITCH_ON_DISABLED]:
        model.statusword &= ~_OFF_SUPPLY


@pytest.mark.parametrize(
    ("word", "reason"),
    [
        (0x047D, Reason.COAST_STOP),
        (0x047C, Reason.COAST_STOP),
        (0x007F, Reason.NO_CONTROL),
        (None, Reason.PLC_LOST),
    ],
)
def test_supply_bit_of_another_state_hides_no_order_of_the_plc(word: int | None, reason: Reason) -> None:
    def before(daemon: Daemon) -> None:
        drive_of(daemon).model.disguises.append(show_supply_above_switch_on_disabled)

    with running(configuration(axis(1), transport=SLOW_PLC), before) as daemon:
        plc = Plc(daemon, [1])
        plc.enable()
        for ready in (0x047E, 0x007E, 0x047E):
            send(plc, ready, 50)
        assert state_of(daemon.axes[0].drive.feedback.statusword) is State.READY_TO_SWITCH_ON
        send(plc, 0x047D, 50)
        if word is None:
            plc.silent = True
            run_out(plc)
        else:
            send(plc, word, 50)
        assert state_of(daemon.axes[0].drive.feedback.statusword) is State.SWITCH_ON_DISABLED
        assert texts(daemon)[0] is (Reason.HELD_OFF if word == 0x047D else reason)


@pytest.mark.parametrize(("word", "reason"), [(0x047F, Reason.NO_SUPPLY), (0x047E, Reason.SWITCHED_OFF)])
def test_supply_is_missing_while_on_is_commanded(word: int, reason: Reason) -> None:
    with in_operation() as (daemon, plc):
        drive_of(daemon).model.disguises.append(show_no_supply)
        run_out(plc)
        send(plc, word, 100)
        assert texts(daemon)[0] is reason


def test_open_sto_is_not_a_missing_supply_where_the_drive_never_shows_it() -> None:
    def before(daemon: Daemon) -> None:
        drive_of(daemon).model.disguises.append(show_supply_above_switch_on_disabled)

    with running(configuration(axis(1), transport=SLOW_PLC), before) as daemon:
        plc = Plc(daemon, [1])
        plc.enable()
        send(plc, 0x047D, 50)
        drive_of(daemon).model.disguises.insert(0, show_inhibited)
        send(plc, 0x047E, 50)
        send(plc, 0x047F, 50)
        reason, evidence, _ = texts(daemon)
        assert reason is Reason.INHIBITED
        assert evidence.endswith("after ON: safe torque off (STO), enable input or supply")


def show_inhibited(model: DriveModel, _: int) -> None:
    """The drive stays in Switch On Disabled: safe torque off."""
    model.statusword = STATUS_OF[State.SWITCH_ON_DISABLED] | StatusBit.REMOTE | _OFF_SUPPLY
