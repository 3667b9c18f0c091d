"""Each bit of STW1 that is 0 has the effect and the reason of the table, and texts name the missing bits alone."""

from __future__ import annotations

import re
from itertools import combinations

import pytest

from pdgw.gateway.objects.bit_effects import BIT_EFFECTS, BitEffect, Missing
from pdgw.gateway.reasons import Reason
from tests.support.documents.situations import clear_bits, in_operation, run_out

_SETPOINT = [row.bit for row in BIT_EFFECTS if row.reason is Reason.SETPOINT_DISABLED]
_ENABLES = [row.bit for row in BIT_EFFECTS if row.bit not in _SETPOINT]


def named(text: str) -> set[int]:
    """The bits of STW1 that a text names beside ON."""
    return {int(bit) for bit in re.findall(r"STW1\.(\d+)", text)} - {0}


@pytest.mark.parametrize("row", BIT_EFFECTS, ids=lambda row: f"STW1.{row.bit}")
def test_a_bit_that_is_0_gives_the_reason_of_its_row(row: BitEffect) -> None:
    with in_operation() as (daemon, plc):
        clear_bits(plc, 1 << row.bit)
        seen = set()
        for _ in range(200):
            plc.exchange()
            link = daemon.axes[0].enable_status.broken
            seen |= {daemon.axes[0].reason, None if link is None else link.reason}
        assert row.reason in seen


@pytest.mark.parametrize("bits", [bits for n in (1, 2, 3) for bits in combinations(_SETPOINT, n)], ids=str)
def test_a_missing_setpoint_names_the_bits_that_are_0_alone(bits: tuple[int, ...]) -> None:
    with in_operation() as (daemon, plc):
        clear_bits(plc, sum(1 << bit for bit in bits))
        run_out(plc)
        link = daemon.axes[0].enable_status.broken
        assert link is not None
        assert named(link.evidence) == named(link.remedy) == set(bits)


@pytest.mark.parametrize("bits", [bits for n in (1, 2, 3) for bits in combinations(_ENABLES, n)], ids=str)
def test_a_drive_held_off_names_the_bits_that_are_0_alone(bits: tuple[int, ...]) -> None:
    with in_operation() as (daemon, plc):
        clear_bits(plc, sum(1 << bit for bit in bits))
        run_out(plc)
        link = daemon.axes[0].enable_status.broken
        assert link is not None
        assert named(link.evidence) == set(bits)


@pytest.mark.parametrize("bits", [(1,), (2,), (1, 2)], ids=str)
def test_a_drive_that_is_off_names_the_bits_of_its_stop_alone(bits: tuple[int, ...]) -> None:
    with in_operation() as (daemon, plc):
        clear_bits(plc, 1 | sum(1 << bit for bit in bits))
        run_out(plc)
        link = daemon.axes[0].enable_status.broken
        assert link is not None
        assert link.reason in (Reason.COAST_STOP, Reason.QUICK_STOP)
        assert named(link.remedy) == set(bits)


def test_missing_bits_are_one_equation() -> None:
    missing = Missing.of("STW1", 0x0404, Reason.COAST_STOP, Reason.QUICK_STOP, Reason.ENABLE_MISSING)
    assert missing.set_to(0) == "STW1.1 = STW1.3 = 0"
    assert missing.set_to(1) == "STW1.1 = STW1.3 = 1"
    assert Missing.of("STW1", 0xFFFF, Reason.COAST_STOP).set_to(0) == ""
