"""Shapes of simulated drives: what 100 % is for each, found from its objects, is what its motor does."""

from __future__ import annotations

import struct

import pytest

from pdgw.base.durations import MS
from pdgw.ds301.aborts import Abort, CanopenError, SdoAbortedError
from pdgw.ds301.communication import NmtCommand
from pdgw.dsp402.drive_type import Quantity
from pdgw.dsp402.states import State
from pdgw.peers.drive import ENGEL, LINEAR_AXIS, SHAPES, Machine, SimulatedDriveNode, shape
from pdgw.peers.drive.model.shapes import ENDLESS, SYNCHRONOUS
from tests.support.drives.drive_types import described
from tests.support.drives.node_bench import NodeBench

NODE = 3
ALL = sorted(SHAPES)
DRIVEN = [name for name in ALL if name not in {"slow-boot", "two-edges", "csp"}]
"""By a speed, as soon as they are switched on."""


class Bench(NodeBench[SimulatedDriveNode]):
    """A drive of a shape, commanded through its objects and looked at when it says that something is due."""

    def __init__(self, name: str, machine: Machine | None = None) -> None:
        super().__init__(lambda send: SimulatedDriveNode(NODE, send, shape=shape(name), machine=machine))
        self.run(1)

    def run(self, milliseconds: int) -> None:
        end = self.now + milliseconds * MS
        while (event := self.node.next_event(self.now)) is not None and event < end:
            self.now = max(event, self.now)
            self.node.poll(self.now)
            self.now += 1
        self.now = end
        self.node.poll(self.now)

    def write(self, index: int, value: int, subindex: int = 0) -> None:
        self.set(index, value, subindex)
        self.node.touch()

    def enable(self, mode: int) -> None:
        if (0x6060, 0) in self.node.entries:
            self.write(0x6060, mode)
        for word in (0x06, 0x07, 0x0F):
            self.write(0x6040, word)
            self.run(5)
        assert self.node.model.state is State.OPERATION_ENABLED

    @property
    def rpm(self) -> float:
        return self.node.model.ramp.speed


@pytest.mark.parametrize("name", DRIVEN)
def test_100_percent_as_it_is_found_is_the_rated_speed_of_the_motor(name: str) -> None:
    drive = described(name)
    reference = drive.scaling.reference(Quantity.SPEED)
    assert reference.denominator == 1
    mode = drive.speed_mode
    assert mode is not None
    bench = Bench(name)
    bench.enable(mode)
    if name in ("vl", "inverter"):
        bench.write(0x6040, 0x7F)
    entry = drive.entry("target_velocity")
    bench.write(entry.index, int(reference))
    bench.run(3000)
    assert bench.rpm == pytest.approx(3000, abs=1e-6)
    assert bench.node.model.velocity_actual == reference
    bench.write(entry.index, -int(reference) // 2)
    bench.run(3000)
    assert bench.rpm == pytest.approx(-1500, abs=1e-2)


@pytest.mark.parametrize(
    ("name", "modes", "missing"),
    [
        ("engel", {-5, -4, -3, 1, 3, 4, 6}, ()),
        ("rpm", {1, 3, 6}, ()),
        ("counts", {1, 3, 6}, ()),
        ("vl", {2}, (Quantity.ACCELERATION, Quantity.DECELERATION)),
        ("csv", {6, 9}, ()),
        ("no-range", {1, 3, 6}, (Quantity.ACCELERATION, Quantity.DECELERATION)),
    ],
)
def test_what_a_shape_offers_and_lacks(name: str, modes: set[int], missing: tuple[Quantity, ...]) -> None:
    drive = described(name)
    assert {*drive.modes} == modes
    assert tuple(quantity for quantity in Quantity if drive.scaling.refusal(quantity)) == missing


def test_a_drive_without_range_limit_takes_any_position() -> None:
    assert described("no-range").scaling.position_range is None
    bench = Bench("no-range")
    bench.enable(1)
    bench.write(0x607A, 40_960)
    bench.write(0x6040, 0x1F)
    bench.run(3000)
    assert bench.node.model.position_actual == 40_960


@pytest.mark.parametrize(("name", "shown"), [("rpm", -400_000), ("range-limit", 600_000), ("no-range", 600_000)])
def test_position_wraps_at_607bh_unless_the_variant_says_otherwise(name: str, shown: int) -> None:
    bench = Bench(name)
    bench.node.model.zero = -600_000
    bench.enable(3)
    bench.run(10)
    assert bench.node.model.position_actual == shown


def test_shaft_turns_without_limit_and_slide_reaches_its_switch() -> None:
    turning, sliding = Bench("rpm"), Bench("rpm", LINEAR_AXIS)
    for bench in (turning, sliding):
        bench.enable(3)
        bench.write(0x60FF, 1500)
        bench.run(60_000)
    assert turning.rpm == 1500
    assert sliding.rpm == 0


def test_velocity_mode_lets_the_setpoint_through_only_with_its_ramp_bits() -> None:
    bench = Bench("vl")
    bench.enable(2)
    bench.write(0x6042, 1000)
    bench.run(1000)
    assert bench.rpm == 0
    bench.write(0x6040, 0x7F)
    bench.run(1000)
    assert bench.rpm == pytest.approx(1000)


def test_a_fixed_mapping_cannot_be_written_and_is_the_predefined_one() -> None:
    bench = Bench("fixed-pdo")
    for index, subindex, value in ((0x1600, 0, 0), (0x1A00, 1, 0x60410010), (0x1400, 1, 0x8000_0203)):
        with pytest.raises(SdoAbortedError) as error:
            bench.write(index, value, subindex)
        assert error.value.code == Abort.READ_ONLY
    drive = described("fixed-pdo")
    assert not any(slot.mapping_writable or slot.cob_id_writable for slot in (*drive.pdos.rpdos, *drive.pdos.tpdos))
    assert drive.pdos.rpdos[3].mapping == (0x60400010, 0x60FF0020)


def test_tpdos_without_event_timer() -> None:
    assert not any(slot.event_timer for slot in described("no-event-timer").pdos.tpdos)
    with pytest.raises(SdoAbortedError) as error:
        Bench("no-event-timer").write(0x1800, 50, 5)
    assert error.value.code == Abort.NO_SUCH_SUBINDEX


def test_four_pdos_of_each_direction() -> None:
    pdos = described("four-pdo").pdos
    assert (len(pdos.rpdos), len(pdos.tpdos)) == (4, 4)


def test_slow_drive_is_silent_for_15_s_after_each_reset() -> None:
    bench = Bench("slow-boot")
    for _ in range(2):
        bench.frames.clear()
        bench.run(14_990)
        bench.node.receive(0x600 + NODE, struct.pack("<BHB4x", 0x40, 0x1000, 0), bench.now)
        assert bench.frames == []
        bench.run(20)
        assert [frame[1:] for frame in bench.frames] == [(0x700 + NODE, b"\0")]
        bench.node.receive(0, bytes((NmtCommand.RESET_NODE, NODE)), bench.now)


def test_a_guarded_drive_answers_with_its_state_and_a_toggle() -> None:
    bench = Bench("node-guarding")
    bench.frames.clear()
    for _ in range(3):
        bench.node.receive_remote(0x700 + NODE, bench.now)
    assert [frame[1:] for frame in bench.frames] == [(0x700 + NODE, bytes([state])) for state in (0x7F, 0xFF, 0x7F)]


def test_a_drive_whose_master_stops_guarding_reacts_as_6007h_says() -> None:
    bench = Bench("node-guarding")
    bench.write(0x6007, 3)
    bench.write(0x100C, 50)
    bench.write(0x100D, 3)
    bench.node.receive(0, bytes((NmtCommand.START, NODE)), bench.now)
    bench.enable(3)
    bench.write(0x60FF, 1000)
    for _ in range(20):
        bench.node.receive_remote(0x700 + NODE, bench.now)
        bench.run(100)
    assert bench.rpm == 1000
    bench.run(1000)
    assert bench.rpm == 0
    assert bench.node.model.state is State.SWITCH_ON_DISABLED


def test_every_variant_except_the_first_has_an_unknown_vendor() -> None:
    for name, item in SHAPES.items():
        assert described(name).family == ("engel" if item in (ENGEL, SYNCHRONOUS, ENDLESS) else "")


def test_unknown_variant_is_rejected_with_the_known_names() -> None:
    with pytest.raises(CanopenError, match="fixed-pdo"):
        shape("round")
