"""When an object of a TPDO is found out never to come in it, and when not."""

from __future__ import annotations

from pdgw.dsp402.pdo.layouts import LAYOUTS, Operation
from pdgw.dsp402.pdo.value_check import CONTRADICTIONS, PdoValueCheck

PDO = LAYOUTS[Operation.VELOCITY].tpdos[0]
SHOWN, HELD = bytes(4), b"\1\0\0\0"
"""Velocity Actual Value after the Statusword in the TPDO, and the value of the object."""
FRAME = b"\x37\x02" + SHOWN


def test_object_that_contradicts_every_newer_frame_is_detected() -> None:
    check = PdoValueCheck([PDO])
    for time in range(CONTRADICTIONS):
        check.see(PDO, FRAME, 10 * time)
        (suspect,) = check.unconfirmed
        assert check.compare(suspect, HELD, 10 * time + 5) == (time == CONTRADICTIONS - 1)


def test_without_a_newer_frame_no_conclusion_is_drawn() -> None:
    check = PdoValueCheck([PDO])
    check.see(PDO, FRAME, 0)
    (suspect,) = check.unconfirmed
    assert not any(check.compare(suspect, HELD, time) for time in range(1, 10))
    check.see(PDO, b"\x37\x02" + HELD, 20)
    assert not list(check.unconfirmed)


def test_one_agreement_restarts_the_check() -> None:
    check = PdoValueCheck([PDO])
    for time, held in enumerate((HELD, HELD, SHOWN, HELD, HELD)):
        check.see(PDO, FRAME, 10 * time)
        (suspect,) = check.unconfirmed
        assert not check.compare(suspect, held, 10 * time + 5)
        assert check.contradicted == (held == HELD)


BOTH = LAYOUTS[Operation.TRANSPARENT].tpdos[1]
"""Position and velocity in one PDO."""


def test_each_object_of_a_pdo_has_its_own_place() -> None:
    check = PdoValueCheck([BOTH])
    check.see(BOTH, bytes(8), 0)
    check.see(BOTH, bytes(4) + HELD, 1)
    (suspect,) = check.unconfirmed
    assert suspect.entry.attribute == "position_actual", "the other one has changed"
    check.see(BOTH, HELD + HELD, 2)
    assert not check.has_unconfirmed


def test_contradicted_object_is_checked_again_sooner() -> None:
    check = PdoValueCheck([BOTH])
    check.see(BOTH, bytes(8), 0)
    position, velocity = check.unconfirmed
    check.compare(position, SHOWN, 1)
    check.compare(velocity, HELD, 1)
    assert check.contradicted


def test_frame_of_another_pdo_does_not_count() -> None:
    check = PdoValueCheck([PDO, BOTH])
    check.see(PDO, FRAME, 0)
    (suspect,) = check.unconfirmed
    assert suspect.pdo is PDO, "nothing came of the others"
    for time in range(1, 10):
        check.see(BOTH, bytes(8), 10 * time)
        assert not check.compare(suspect, HELD, 10 * time + 5)


def test_unreadable_object_is_trusted() -> None:
    check = PdoValueCheck([PDO])
    check.see(PDO, FRAME, 0)
    (suspect,) = check.unconfirmed
    check.trust(suspect)
    assert not check.has_unconfirmed
