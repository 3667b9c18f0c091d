"""Remedies that are enough: a program that does what the sentence says, and nothing else, has what it asked for."""

from __future__ import annotations

import pytest

from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.daemon.daemon import Daemon
from tests.support.documents.device_situations import MDI, POSITIONER
from tests.support.documents.situations import in_operation, run_out
from tests.support.gateways.daemon import Plc, axis

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
    return (None, "", "") if link is None else (link.reason, link.evidence, link.remedy)


def send(plc: Plc, word: int, cycles: int = 20, **values: int) -> None:
    """The PLC sends STW1 and other words."""
    plc.endpoint.set(0, {"STW1": word, **values})
    plc.exchange(cycles)


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
        assert remedy == "after the homing, set STW1.11 to 0; then set STW1.6 to 0 and to 1"
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
