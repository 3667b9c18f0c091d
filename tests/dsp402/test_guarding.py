"""What stops a drive when the gateway dies: the first of heartbeat, life guarding and RPDO time-out that the drive takes."""

from __future__ import annotations

import pytest

from pdgw.ds301.aborts import Abort, SdoAbortedError
from pdgw.ds301.communication import CONSUMER_HEARTBEAT, GUARD_TIME, LIFE_TIME_FACTOR, PRODUCER_HEARTBEAT
from pdgw.ds301.configuration import EVENT_TIMER, SdoStep
from pdgw.dsp402.drive.guarding import Guarding, GuardTimes, guard, write_interpolation
from pdgw.dsp402.drive_type import Dsp402Error
from pdgw.dsp402.objects import ABORT_OPTION

RPDO = 0x1400
QUICK_STOP = 3


class Node:
    """A drive with the objects ``indices``. It keeps each value that is written. The objects of ``fixed`` are read-only.

    ``rounds``: it rounds times up to multiples of this, in milliseconds.
    """

    def __init__(
        self, *indices: int, fixed: dict[int, int] | None = None, beats_always: bool = False, rounds: int = 1
    ) -> None:
        self.rounds = rounds
        self.fixed = fixed or {}
        self.indices = {*indices, *self.fixed}
        self.values: dict[int, int] = dict(self.fixed)
        self.beats_always = beats_always
        self.unreadable: int | None = None

    def write(self, step: SdoStep) -> int:
        if step.index not in self.indices:
            raise SdoAbortedError(Abort.NO_SUCH_OBJECT)
        if step.index in self.fixed or (self.beats_always and step.index == PRODUCER_HEARTBEAT and not step.value):
            raise SdoAbortedError(Abort.READ_ONLY)
        if step.index == RPDO:
            assert step.subindex == EVENT_TIMER
        held = self.values[step.index] = -(-step.value // self.rounds) * self.rounds if step.time else step.value
        if not step.is_held_by(held):
            raise Dsp402Error(step.meaning, held, f"{step.value} when read back")
        return held

    def read(self, index: int, subindex: int) -> int:
        if index == CONSUMER_HEARTBEAT and index in self.indices:
            return self.values.get(index, 0) if subindex else 1
        if self.unreadable is not None:
            raise SdoAbortedError(self.unreadable)
        if index not in self.indices:
            raise SdoAbortedError(Abort.NO_SUCH_OBJECT)
        return self.values[index]

    def guarded(self, heartbeat_ms: int = 100, reaction: int = QUICK_STOP) -> Guarding:
        return guard(GuardTimes(127, heartbeat_ms, 3, 50, reaction, RPDO), self.write, self.read)


LIFE = (GUARD_TIME, LIFE_TIME_FACTOR)


def test_heartbeat_of_the_gateway_is_the_first_choice_of_guarding() -> None:
    node = Node(CONSUMER_HEARTBEAT, PRODUCER_HEARTBEAT, ABORT_OPTION, *LIFE, RPDO)
    found = node.guarded()
    assert (found.heartbeat, found.life_guarding, found.rpdos, found.refusal) == (True, False, False, "")
    assert found.text == "the gateway's heartbeat (1016h, 300 ms), then quick stop (6007h = 3)"
    assert node.values[CONSUMER_HEARTBEAT] == 127 << 16 | 300
    assert set(node.values) == {CONSUMER_HEARTBEAT, PRODUCER_HEARTBEAT, ABORT_OPTION}


def test_no_heartbeat_is_awaited_from_a_drive_without_one() -> None:
    found = Node(CONSUMER_HEARTBEAT, ABORT_OPTION).guarded()
    assert (found.heartbeat, found.refusal) == (False, "")
    assert "TPDOs only" in found.text
    assert not Node(CONSUMER_HEARTBEAT, PRODUCER_HEARTBEAT, ABORT_OPTION).guarded(heartbeat_ms=0).heartbeat


@pytest.mark.parametrize("has_producer", [True, False])
def test_life_guarding_is_the_second_choice_and_stops_the_drives_heartbeat(has_producer: bool) -> None:
    producer = (PRODUCER_HEARTBEAT,) if has_producer else ()
    node = Node(*producer, ABORT_OPTION, *LIFE, RPDO)
    found = node.guarded()
    assert (found.heartbeat, found.life_guarding, found.rpdos, found.refusal) == (False, True, False, "")
    assert node.values.get(PRODUCER_HEARTBEAT, 0) == 0
    assert (node.values[GUARD_TIME], node.values[LIFE_TIME_FACTOR]) == (100, 3)


def test_a_drive_whose_heartbeat_cannot_be_switched_off_is_not_life_guarded() -> None:
    node = Node(PRODUCER_HEARTBEAT, ABORT_OPTION, *LIFE, RPDO, beats_always=True)
    found = node.guarded()
    assert (found.heartbeat, found.life_guarding, found.rpdos, found.refusal) == (True, False, True, "")
    assert GUARD_TIME not in node.values


@pytest.mark.parametrize("life", [(), (GUARD_TIME,), (LIFE_TIME_FACTOR,)])
def test_rpdo_timeout_is_the_last_choice_and_keeps_the_drives_heartbeat(life: tuple[int, ...]) -> None:
    node = Node(PRODUCER_HEARTBEAT, ABORT_OPTION, RPDO, *life)
    found = node.guarded()
    assert (found.heartbeat, found.life_guarding, found.rpdos, found.refusal) == (True, False, True, "")
    assert (node.values[PRODUCER_HEARTBEAT], node.values[RPDO]) == (100, 150)
    assert not Node(ABORT_OPTION, RPDO).guarded().heartbeat
    assert not Node(PRODUCER_HEARTBEAT, ABORT_OPTION, RPDO).guarded(heartbeat_ms=0).heartbeat


@pytest.mark.parametrize(
    ("has", "text"),
    [(LIFE, "life guarding (100Ch, 100Dh, 324 ms)"), ((RPDO,), "the timeout of its RPDO (1400h/5, 153 ms)")],
)
def test_a_drive_that_rounds_times_guards_with_the_time_that_it_holds(has: tuple[int, ...], text: str) -> None:
    found = Node(PRODUCER_HEARTBEAT, ABORT_OPTION, *has, rounds=9).guarded()
    assert (found.heartbeat, found.life_guarding, found.refusal) == (has != LIFE, has == LIFE, "")
    assert found.text == f"{text}, then quick stop (6007h = 3)"
    assert Node(CONSUMER_HEARTBEAT, PRODUCER_HEARTBEAT, ABORT_OPTION, rounds=9).guarded().heartbeat
    assert Node(ABORT_OPTION, *has, rounds=1000).guarded().refusal, "another time than the one asked for"


def test_drive_without_guarding_is_rejected() -> None:
    found = Node(PRODUCER_HEARTBEAT, ABORT_OPTION).guarded()
    assert (found.text, found.heartbeat, found.rpdos) == ("nothing", True, False)
    assert found.refusal


@pytest.mark.parametrize(
    ("held", "text", "stops"),
    [
        (0, "then nothing (6007h = 0)", False),
        (1, "then malfunction (6007h = 1)", True),
        (2, "then disable voltage (6007h = 2)", True),
        (-5, "then a reaction of the manufacturer (6007h = -5)", True),
    ],
)
def test_read_only_reaction_is_accepted_unless_it_means_no_reaction(held: int, text: str, stops: bool) -> None:
    found = Node(CONSUMER_HEARTBEAT, PRODUCER_HEARTBEAT, fixed={ABORT_OPTION: held}).guarded()
    assert found.text.endswith(text)
    assert (found.refusal == "") is stops


def test_a_drive_without_6007h_has_its_own_reaction_and_one_that_hides_it_is_refused() -> None:
    node = Node(CONSUMER_HEARTBEAT, PRODUCER_HEARTBEAT)
    assert "its own reaction" in node.guarded().text
    assert not node.guarded().refusal
    node.unreadable = Abort.GENERAL
    found = node.guarded()
    assert "cannot be read" in found.text
    assert found.refusal


def test_configured_absence_of_a_reaction_is_accepted() -> None:
    found = Node(CONSUMER_HEARTBEAT, PRODUCER_HEARTBEAT, ABORT_OPTION).guarded(reaction=0)
    assert found.text.endswith("then nothing (6007h = 0)")
    assert not found.refusal


class Consumers:
    """A drive with these entries of 1016h, and no other way of guarding."""

    def __init__(self, *entries: int, least_ms: int = 0, empty_first: bool = False) -> None:
        self.entries = dict(enumerate(entries, 1))
        self.least_ms = least_ms
        self.empty_first = empty_first

    def write(self, step: SdoStep) -> int:
        if step.index != CONSUMER_HEARTBEAT:
            raise SdoAbortedError(Abort.NO_SUCH_OBJECT)
        if step.subindex not in self.entries:
            raise SdoAbortedError(Abort.NO_SUCH_SUBINDEX)
        if step.value:
            others = [value >> 16 for number, value in self.entries.items() if number != step.subindex and value]
            if step.value >> 16 in others or (self.empty_first and self.entries[step.subindex]):
                raise SdoAbortedError(Abort.PARAMETER_INCOMPATIBLE)
            if step.value & 0xFFFF < self.least_ms:
                raise SdoAbortedError(Abort.VALUE_RANGE)
        self.entries[step.subindex] = step.value
        return step.value

    def read(self, index: int, subindex: int) -> int:
        if index != CONSUMER_HEARTBEAT:
            raise SdoAbortedError(Abort.NO_SUCH_OBJECT)
        return self.entries[subindex] if subindex else len(self.entries)

    def guarded(self) -> Guarding:
        return guard(GuardTimes(127, 100, 3, 50, QUICK_STOP, RPDO), self.write, self.read)


OWN, OTHER = 127 << 16 | 300, 5 << 16 | 1000


@pytest.mark.parametrize(
    ("device", "entries", "used"),
    [
        (Consumers(0, 0, 127 << 16 | 1000, 0), [0, 0, OWN, 0], 3),
        (Consumers(OTHER, 0), [OTHER, OWN], 2),
        (Consumers(127 << 16 | 1000, empty_first=True), [OWN], 1),
        (Consumers(127 << 16, 0), [OWN, 0], 1),
    ],
    ids=["own entry", "free entry", "own entry that must be 0 first", "own entry without a time"],
)
def test_heartbeat_consumer_is_the_entry_of_the_gateway(device: Consumers, entries: list[int], used: int) -> None:
    found = device.guarded()
    assert (found.refusal, found.entry) == ("", used)
    assert list(device.entries.values()) == entries


def test_entries_of_other_nodes_are_never_cleared() -> None:
    device = Consumers(OTHER, 6 << 16 | 1000)
    found = device.guarded()
    assert list(device.entries.values()) == [OTHER, 6 << 16 | 1000]
    assert found.refusal == "1016h: all entries have other nodes"
    assert found.remedy == "write 0 to an entry of 1016h that is not needed any more, with the drive's own tool"


def test_time_that_is_refused_names_the_key_and_not_the_end_of_the_guarding() -> None:
    found = Consumers(0, least_ms=500).guarded()
    assert found.remedy.startswith(
        "set another heartbeat_ms than 100, for example 200 (the drive refuses 300 ms, 3 times"
    )
    assert "allow_unguarded" not in found.remedy
    assert "allow_unguarded = true" in Node(ABORT_OPTION).guarded().remedy


class Interpolation:
    """A drive that takes these powers of ten, and these counts."""

    def __init__(self, exponents: tuple[int, ...], highest: int = 255) -> None:
        self.exponents = exponents
        self.highest = highest
        self.held = {1: 1, 2: exponents[0]}

    def write(self, step: SdoStep) -> int:
        assert step.subindex == 2 or 1 <= step.value <= 255, "a count that 60C2h/1 can have"
        allowed = step.value in self.exponents if step.subindex == 2 else step.value <= self.highest
        if not allowed:
            raise SdoAbortedError(Abort.VALUE_RANGE)
        self.held[step.subindex] = step.value
        return step.value


@pytest.mark.parametrize(
    ("exponents", "period_us", "count", "exponent"),
    [
        ((-3, -4), 4000, 4, -3),
        ((-4,), 4000, 40, -4),
        ((-5,), 2000, 200, -5),
        ((-6, -4), 4000, 40, -4),
        ((-2,), 20_000, 2, -2),
        ((-3, -6), 250, 250, -6),
    ],
)
def test_interpolation_time_has_a_power_of_ten_that_the_drive_takes(
    exponents: tuple[int, ...], period_us: int, count: int, exponent: int
) -> None:
    drive = Interpolation(exponents)
    write_interpolation(period_us, drive.write, drive.held[2])
    assert drive.held == {1: count, 2: exponent}


@pytest.mark.parametrize("drive", [Interpolation((-5,)), Interpolation((-6,)), Interpolation((-4,), highest=30)])
def test_interpolation_time_that_no_power_of_the_drive_fits_is_refused(drive: Interpolation) -> None:
    with pytest.raises(
        Dsp402Error, match=r"interpolation time 60C2h: '4000 us' is not allowed, expected 1 to 255 times"
    ):
        write_interpolation(4000, drive.write, drive.held[2])
