"""Faults and warnings: ZSW1.3 and ZSW1.7 show what P947 and P953 have, and an EMCY is a fault only if the drive shows one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import permutations
from random import Random

import pytest

from pdgw.base.durations import SECOND
from pdgw.dsp402.states import State, StatusBit, state_of
from pdgw.gateway.axis.telegrams import DRIVE_TELEGRAM_NUMBERS, ENCODER_TELEGRAM_NUMBERS
from pdgw.gateway.axis.values import FaultRecord
from pdgw.gateway.base.fault_numbers import EMCY_WARNING
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.objects.fault_buffer import FaultLog
from pdgw.gateway.service.status import snapshot
from pdgw.peers.drive import DriveModel
from pdgw.profidrive.parameters.description import Pnu
from pdgw.profidrive.parameters.faults import FAULTS_PER_SITUATION, SIZE, Fault
from pdgw.profidrive.signals import signal
from pdgw.tools.output.status_text import status_lines
from tests.support.gateways.daemon import (
    OFF,
    ON,
    POSITIONER,
    Plc,
    axis,
    configuration,
    drive_of,
    encoder_of,
    online,
    operating,
    running,
    switch_off,
)
from tests.support.gateways.fault_display import FaultDisplay

FAULT, WARNING, ACKNOWLEDGE = 0x08, 0x80, 0x80
_DSC = 'dsc = "speed"\nfollowing_window = 10000\n'
KEYS = dict.fromkeys((5, 6, 105, 106), _DSC) | dict.fromkeys((7, 110, 111, 112), POSITIONER)
"""Further keys of telegrams that need some."""


class Rig:
    """An axis in operation at 1500 rpm; each cycle is checked."""

    def __init__(self, daemon: Daemon, plc: Plc) -> None:
        self.daemon, self.plc = daemon, plc
        self.axis = daemon.axes[0]
        self.display = FaultDisplay(daemon, self.axis)
        self.cycles(1)

    def cycles(self, count: int) -> None:
        for _ in range(count):
            self.plc.exchange()
            self.display()

    def seconds(self, seconds: float) -> None:
        self.cycles(round(seconds * SECOND) // self.daemon.cycle_ns)

    def until(self, condition: Callable[[], object]) -> None:
        end = self.plc.loop.now() + 10 * SECOND
        while not condition():
            assert self.plc.loop.now() < end, self.state
            self.cycles(1)

    def emergency(self, code: int, register: int = 1) -> None:
        drive_of(self.daemon).do(lambda node: node.send_emcy(code, register))

    @property
    def word(self) -> int:
        return self.plc.value("ZSW1")

    @property
    def state(self) -> tuple[bool, bool, list[int], int]:
        """ZSW1.3, ZSW1.7, P947 and P953."""
        return bool(self.word & FAULT), bool(self.word & WARNING), self.display.faults, self.display.warnings

    @property
    def records(self) -> list[tuple[int, int, bool]]:
        """Number, code and kind of each reported fault and warning."""
        return [(record.number, record.code, record.is_warning) for record in self.axis.faults]

    def acknowledge(self) -> None:
        word = self.plc.endpoint.setpoints[0]["STW1"]
        for stw1 in (word | ACKNOWLEDGE, word):
            self.plc.endpoint.set(0, {"STW1": stw1})
            self.cycles(5)


@pytest.fixture
def rig() -> Iterator[Rig]:
    with operating() as (daemon, plc):
        plc.turn(0x2000)
        yield Rig(daemon, plc)


@pytest.mark.parametrize(("code", "number"), [(0xFF07, 10), (0x4310, 1), (0x8120, 12), (0x8130, 12)])
def test_emergency_in_operation_is_a_warning_until_its_end(rig: Rig, code: int, number: int) -> None:
    rig.emergency(code)
    rig.seconds(1)
    assert rig.state == (False, True, [], EMCY_WARNING)
    assert rig.records == [(number, code, True)]
    rig.emergency(0, 0)
    rig.seconds(0.1)
    assert rig.state == (False, False, [], 0)
    assert rig.word & 0x07 == 0x07


def test_end_of_one_of_two_errors_leaves_the_warning(rig: Rig) -> None:
    rig.emergency(0x4310, 0x09)
    rig.emergency(0xFF07, 0x29)
    rig.seconds(1)
    rig.emergency(0, 0x01)
    rig.seconds(0.1)
    assert rig.state == (False, True, [], EMCY_WARNING)
    rig.emergency(0, 0)
    rig.seconds(0.1)
    assert rig.state == (False, False, [], 0)


def test_acknowledge_ends_the_warning_of_an_emergency(rig: Rig) -> None:
    rig.emergency(0xFF07)
    rig.seconds(1)
    rig.acknowledge()
    assert rig.state == (False, False, [], 0)


def test_fault_right_after_its_emergency_is_reported_once(rig: Rig) -> None:
    drive_of(rig.daemon).inject(7)
    rig.until(lambda: rig.word & FAULT)
    rig.seconds(1)
    assert rig.state == (True, False, [7], 0)
    assert [(number, is_warning) for number, _, is_warning in rig.records] == [(7, False)]


def test_emergency_after_the_statusword_that_shows_its_fault_is_its_fault(rig: Rig) -> None:
    with silent_emergencies(rig):
        drive_of(rig.daemon).do(lambda node: node.model.inject(7))
        rig.until(lambda: rig.word & FAULT)
        rig.cycles(20)
    rig.emergency(0x5000)
    rig.seconds(1)
    assert rig.records == [(10, 0x5000, False)]


def test_later_fault_without_an_emergency_has_the_code_of_the_warning(rig: Rig) -> None:
    rig.emergency(0x4310)
    rig.seconds(3)
    with silent_emergencies(rig):
        drive_of(rig.daemon).do(lambda node: node.model.inject(7))
        rig.until(lambda: rig.word & FAULT)
        rig.seconds(1)
    assert rig.records[:2] == [(1, 0x4310, True), (1, 0x4310, False)]
    assert rig.display.faults[0] == 1
    assert not rig.display.warnings


def test_emergency_before_operation_is_left_is_a_fault(rig: Rig) -> None:
    rig.emergency(0xFF07)
    drive_of(rig.daemon).set_enable_input(False)
    rig.until(lambda: rig.word & FAULT)
    rig.seconds(1)
    assert rig.records == [(122, 0xFF12, False), (10, 0xFF07, False)]
    assert rig.state == (True, False, [122, 10], 0)


def test_warning_becomes_a_fault_when_operation_is_left_later(rig: Rig) -> None:
    rig.emergency(0xFF07)
    rig.seconds(3)
    drive_of(rig.daemon).set_enable_input(False)
    rig.seconds(1)
    assert rig.state == (True, False, [122, 10], 0)


def test_emergency_before_the_loss_of_a_turning_drive_is_a_fault(rig: Rig) -> None:
    rig.emergency(0xFF07)
    rig.cycles(2)
    drive_of(rig.daemon).stop()
    rig.until(lambda: 101 in rig.display.faults)
    rig.seconds(0.5)
    assert set(rig.display.faults) == {101, 10}


def test_loss_of_a_turning_drive_leaves_an_older_warning(rig: Rig) -> None:
    rig.emergency(0xFF07)
    rig.seconds(1)
    drive_of(rig.daemon).stop()
    rig.until(lambda: 101 in rig.display.faults)
    rig.seconds(0.5)
    assert rig.display.faults == [101]


def test_lost_plc_is_shown_until_acknowledged_and_does_not_block_the_start(rig: Rig) -> None:
    rig.plc.silent = True
    rig.seconds(2)
    rig.plc.silent = False
    rig.plc.endpoint.set(0, {"STW1": OFF})
    rig.until(lambda: rig.word & 0x47 == 0x01)
    assert rig.state == (True, False, [103], 0)
    rig.plc.endpoint.set(0, {"STW1": ON})
    rig.until(lambda: rig.word & 0x07 == 0x07)
    rig.seconds(1)
    assert rig.word & 0x0F == 0x0F
    rig.until(lambda: rig.plc.value("NIST_A") == 0x2000)
    rig.acknowledge()
    assert rig.state == (False, False, [], 0)
    assert rig.word & 0x07 == 0x07


def test_statusword_warning_without_an_emergency_has_a_sentence(rig: Rig) -> None:
    def warn(model: DriveModel, _: int) -> None:
        model.statusword |= StatusBit.WARNING

    drive_of(rig.daemon).node.model.disguises.append(warn)
    rig.seconds(0.5)
    assert rig.state == (False, True, [], 0x8000)
    assert "Statusword.7" in "".join(status_lines(snapshot(rig.daemon), 400))


def test_status_names_the_emergency_that_warns(rig: Rig) -> None:
    rig.emergency(0xFF07)
    rig.seconds(0.5)
    assert "warning 10: EMCY FF07h" in "".join(status_lines(snapshot(rig.daemon), 400))


def test_unknown_state_that_returns_after_its_acknowledge_is_in_the_buffer(rig: Rig) -> None:
    drive = drive_of(rig.daemon)
    drive.do(lambda node: node.start_fault("unknown-state"))
    rig.until(lambda: rig.display.faults == [107])
    rig.acknowledge()
    assert rig.display.faults == [107], "its cause is still there"
    drive.do(lambda node: node.end_fault())
    rig.cycles(50)
    rig.acknowledge()
    assert not rig.display.faults
    drive.do(lambda node: node.start_fault("unknown-state"))
    rig.until(lambda: rig.word & FAULT)
    rig.cycles(50)
    assert rig.display.faults == [107]


NUMBERS = (*DRIVE_TELEGRAM_NUMBERS, *ENCODER_TELEGRAM_NUMBERS)
EVENTS = 60
"""Events of a run, each with 60 cycles at most."""


@pytest.mark.parametrize("number", NUMBERS)
def test_status_word_shows_faults_and_warnings_after_any_events(number: int) -> None:
    random = Random(number)
    is_drive = number in DRIVE_TELEGRAM_NUMBERS
    if is_drive:
        objects = axis(1, telegram_number=number, more=f"simulate = true\n{KEYS.get(number, '')}")
    else:
        objects = f"[[encoder]]\ndo_id = 1\nnode_id = 20\ntelegram = {number}\nsimulate = true\n"
    with running(configuration(objects, transport="watchdog_factor = 5\ncycle_time_ms = 4")) as daemon:
        online(daemon)
        plc = Plc(daemon, [number])
        device = drive_of(daemon) if is_drive else encoder_of(daemon)
        display = FaultDisplay(daemon, daemon.objects[0])
        word = plc.endpoint.telegrams[0].setpoints.names[0]
        words = (OFF, ON, ON, OFF | ACKNOWLEDGE, 0) if is_drive else (0x0400, 0x0480, 0)
        device.do(lambda node: node.send_emcy(0x4210, 0))
        for _ in range(60):
            plc.exchange()
            display()
        assert display.warnings
        had_fault = False
        events = range(8) if is_drive else (0, 3, 4, 6, 7)
        for _ in range(EVENTS):
            match random.choice(events):
                case 0:
                    code, register = random.choice([(0xFF07, 0x20), (0x8120, 0x11), (0x4210, 0), (0, 0)])
                    device.do(lambda node: node.send_emcy(code, register))  # noqa: B023
                case 1:
                    device.do(lambda node: node.model.inject(random.randrange(1, 13)))
                case 2:
                    device.do(lambda node: node.model.clear())
                case 3:
                    plc.silent = not plc.silent
                case 4:
                    device.do(lambda node: node.restart())
                case 5:
                    name = random.choice(["unknown-state", "enable-input-dropped", "limit-switch", "late-status"])
                    device.do(lambda node: node.start_fault(name))  # noqa: B023
                case 6:
                    device.do(lambda node: node.end_fault())
                case _:
                    display.clear()
            plc.endpoint.set(0, {word: random.choice(words)})
            for _ in range(random.choice([2, 10, 60])):
                plc.exchange()
                display()
            had_fault |= bool(display.faults)
        assert had_fault


def _begins_and_ends() -> Iterator[tuple[str, ...]]:
    """Each order of two of three faults, each of which begins and ends."""
    for first, second in permutations(("drive", "node", "plc"), 2):
        yield first, second, first, second
        yield first, second, second, first
        yield first, first, second, second


@pytest.mark.parametrize("order", [*_begins_and_ends()], ids="-".join)
def test_clearing_the_buffer_leaves_what_lasts_in_any_order(rig: Rig, order: tuple[str, ...]) -> None:
    """P952 := 0 after each begin and end: 7 lasts in the drive's fault, 101 without the node, 103 without the PLC."""
    drive, display = drive_of(rig.daemon), rig.display
    lasting: set[str] = set()
    for name in order:
        lasting ^= {name}
        begins = name in lasting
        if name == "plc":
            rig.plc.silent = begins
        elif name == "node":
            switch_off(rig.daemon, drive) if begins else drive.do(lambda node: node.restart())
        else:
            drive.do(lambda node: node.model.inject(7) if begins else node.model.clear())  # noqa: B023
        rig.seconds(3)
        before = display.faults
        assert {"node": 101, "plc": 103}.get(name, 7) in before or not begins or (name == "drive" and "node" in lasting)
        display.clear()
        rig.seconds(0.1)
        in_fault = "node" in lasting or state_of(drive.node.model.statusword) is State.FAULT
        present = {7: in_fault, 101: "node" in lasting, 103: "plc" in lasting}
        assert display.faults == [number for number in before if present[number]]
        assert not any(display.read(Pnu.FAULT_NUMBER, SIZE)[FAULTS_PER_SITUATION:])
        assert not (lasting or in_fault or rig.word & FAULT) or display.faults


@pytest.mark.parametrize(("number", "word"), [(2, "STW2"), (81, "STW2_ENC")])
def test_lost_sign_of_life_stays_in_a_cleared_buffer_until_it_counts_again(number: int, word: str) -> None:
    encoder = "[[encoder]]\ndo_id = 1\nnode_id = 20\ntelegram = 81\nsimulate = true\n"
    with running(configuration(axis(1, telegram_number=2) if number == 2 else encoder)) as daemon:
        online(daemon)
        plc, item = Plc(daemon, [number]), daemon.objects[0]
        display, life = FaultDisplay(daemon, item), signal(word).bit("SIGN_OF_LIFE")
        item.set_sign_of_life_tolerance(1)
        plc.endpoint.set(0, {"STW1": OFF} if number == 2 else {word: 0x0400})
        plc.endpoint.count(0, word, life)
        plc.exchange(50)
        plc.endpoint.count(0, word, None)
        plc.exchange(50)
        display.clear()
        assert display.faults == [124]
        plc.endpoint.count(0, word, life)
        plc.exchange(50)
        display.clear()
        assert display.faults == []


def test_fault_without_a_place_takes_one_in_the_cleared_buffer() -> None:
    log = FaultLog(0)
    for code in range(7):
        log.enter(FaultRecord(101, code, 0, "", 0))
    log.clear(lambda record: record.code == 6)
    assert log.entries()[:2] == [Fault(101, 6, 0, 0), Fault(0, 0, 0, 0)]
    counter = log.buffer.counter
    log.clear(lambda record: True)
    assert log.buffer.counter == counter, "nothing has changed (P944)"


@contextmanager
def silent_emergencies(rig: Rig) -> Iterator[None]:
    """The drive sends no EMCY."""
    drive = drive_of(rig.daemon)
    send, drive.node.send_emcy = drive.node.send_emcy, lambda *_: None  # type: ignore[method-assign]
    try:
        yield
    finally:
        drive.node.send_emcy = send  # type: ignore[method-assign]
