"""The simulated drive as a CANopen node: SDO aborts, PDOs, heartbeat and NMT, its EDS."""

from __future__ import annotations

import struct

import canopen
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.ds301.aborts import Abort
from pdgw.ds301.communication import NmtState
from pdgw.ds301.eds.writer import write_eds
from pdgw.dsp402.drive.images import DriveCommand, DriveFeedback, attributes
from pdgw.dsp402.objects import DRIVE_OBJECTS
from pdgw.dsp402.pdo.layouts import LAYOUTS, Operation, with_second_position
from pdgw.dsp402.states import State, state_of
from pdgw.peers.drive.objects import EDS_PATH, INFO, OBJECTS, drive_objects
from tests.support.drives.drive_bench import NODE, Bench

ABORTS = [
    (0x5000, 0, b"\0", Abort.NO_SUCH_OBJECT),
    (0x6040, 1, b"\0\0", Abort.NO_SUCH_SUBINDEX),
    (0x6041, 0, b"\0\0", Abort.READ_ONLY),
    (0x6040, 0, b"\0", Abort.LENGTH_TOO_LOW),
    (0x6040, 0, b"\0\0\0\0", Abort.LENGTH_TOO_HIGH),
    (0x6094, 1, bytes(4), Abort.VALUE_TOO_LOW),
    (0x6083, 0, b"\xff\xff\0\0", Abort.VALUE_TOO_HIGH),
    (0x1010, 1, b"evas", Abort.CANNOT_STORE),
    (0x1600, 0, b"\1", Abort.UNSUPPORTED_ACCESS),
]


@pytest.mark.parametrize(("index", "subindex", "data", "abort"), ABORTS)
def test_sdo_aborts_are_those_of_the_standard(index: int, subindex: int, data: bytes, abort: Abort) -> None:
    assert Bench().download(index, subindex, data) == abort


def test_pdo_mapping_needs_an_invalid_pdo_and_count_0_and_checks_objects_and_length() -> None:
    bench = Bench()
    target = OBJECTS.attribute("target_position")
    assert bench.write(0x1600, 1, target.mapping) == Abort.UNSUPPORTED_ACCESS
    assert bench.write(0x1400, 1, 0x8000_0201) == 0
    assert bench.write(0x1600, 1, target.mapping) == Abort.UNSUPPORTED_ACCESS
    assert bench.write(0x1600, 0, 0) == 0
    assert bench.write(0x1600, 1, 0x5000_0010) == Abort.NO_SUCH_OBJECT
    assert bench.write(0x1600, 1, DRIVE_OBJECTS.attribute("statusword").mapping) == Abort.NOT_MAPPABLE
    assert bench.write(0x1600, 1, target.mapping) == 0
    assert bench.write(0x1600, 2, target.mapping) == 0
    assert bench.write(0x1600, 3, target.mapping) == 0
    assert bench.write(0x1600, 0, 3) == Abort.PDO_LENGTH
    assert bench.write(0x1600, 0, 1) == 0
    assert bench.write(0x1400, 1, 0x201) == 0
    bench.node.receive(0x201, struct.pack("<i", -77), bench.now)
    assert bench.model.target_position == -77


def test_a_pdo_that_is_too_short_is_not_used_and_raises_8210h() -> None:
    bench = Bench()
    bench.frames.clear()
    bench.node.receive(0x201, b"\x06", bench.now)
    assert bench.model.state is State.SWITCH_ON_DISABLED
    assert any(data[:2] == b"\x10\x82" for data in bench.sent(0x81))


def test_sync_tpdos_are_sent_on_every_nth_sync_and_event_timer_repeats() -> None:
    bench = Bench()
    bench.write(0x1800, 2, 2)
    bench.frames.clear()
    for _ in range(6):
        bench.node.receive(0x80, b"", bench.now)
        bench.run(1)
    assert len(bench.sent(0x181)) == 3
    bench.write(0x1800, 2, 255)
    bench.write(0x1800, 5, 10)
    bench.run(5)
    bench.frames.clear()
    bench.run(100)
    assert len(bench.sent(0x181)) == 10


def test_inhibit_time_bounds_the_rate_of_a_changing_tpdo() -> None:
    bench = Bench()
    bench.write(0x1800, 3, 50)  # 5 ms
    bench.enable()
    bench.write(0x60FF, 0, 6000)
    bench.frames.clear()
    bench.run(100)
    assert len(bench.sent(0x181)) == 20


@pytest.mark.parametrize(
    ("option", "state"),
    [
        (0, State.OPERATION_ENABLED),
        (1, State.FAULT),
        (2, State.SWITCH_ON_DISABLED),
        (3, State.SWITCH_ON_DISABLED),
    ],
)
def test_a_lost_gateway_heartbeat_is_answered_by_6007h(option: int, state: State) -> None:
    bench = Bench()
    bench.write(0x1016, 1, 127 << 16 | 100)
    bench.write(0x6007, 0, option)
    bench.enable()
    bench.write(0x60FF, 0, 2000)
    for _ in range(10):
        bench.node.receive(0x700 + 127, b"\x05", bench.now)
        bench.run(50)
    assert bench.model.state is State.OPERATION_ENABLED
    bench.run(1000)
    assert bench.model.state is state


def test_leaving_nmt_operational_stops_the_drive() -> None:
    bench = Bench()
    bench.write(0x6007, 0, 3)
    bench.enable()
    bench.node.receive(0, bytes((0x80, NODE)), bench.now)
    bench.run(10)
    assert bench.model.state is State.SWITCH_ON_DISABLED
    assert bench.node.state is NmtState.PRE_OPERATIONAL


def test_heartbeat_shows_the_nmt_state_at_its_period() -> None:
    bench = Bench()
    bench.write(0x1017, 0, 20)
    bench.frames.clear()
    bench.run(100)
    assert bench.sent(0x701) == [b"\x05"] * 5


@given(can_id=st.integers(0, 0x7FF), data=st.binary(max_size=8))
def test_arbitrary_frames_never_raise_in_the_node(can_id: int, data: bytes) -> None:
    bench = Bench()
    bench.node.receive(can_id, data, bench.now)
    bench.run(2)
    assert state_of(bench.model.statusword) is not None


def test_the_eds_in_the_package_is_the_declared_device_and_canopen_reads_it() -> None:
    assert EDS_PATH.read_text(encoding="ascii") == write_eds(INFO, drive_objects()), "run: make docs"
    dictionary = canopen.import_od(str(EDS_PATH), 5)
    assert dictionary[0x1800][1].default == 0x185
    for spec in drive_objects():
        for entry in spec.entries:
            item = dictionary[entry.index]
            variable = item if len(spec.entries) == 1 else item[entry.subindex]
            assert (variable.data_type, variable.access_type) == (entry.type.code, entry.access.value), str(entry)
            assert bool(variable.pdo_mappable) == entry.pdo
            assert (variable.min, variable.max) == (entry.low, entry.high)


def test_images_hold_exactly_the_objects_of_the_layouts() -> None:
    commands = {a for layout in LAYOUTS.values() for pdo in layout.rpdos for a in pdo.attributes}
    feedback = {a for layout in LAYOUTS.values() for pdo in layout.tpdos for a in pdo.attributes}
    assert commands == set(attributes(DriveCommand()))
    last = with_second_position(LAYOUTS[Operation.VELOCITY_WITH_POSITION]).tpdos[-1]
    assert feedback | set(last.attributes) == set(attributes(DriveFeedback()))
