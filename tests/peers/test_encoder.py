"""The simulated encoder in virtual time: objects by SDO, PDOs, cams, diagnostics, storage, motions."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.base.durations import MS
from pdgw.ds301.aborts import Abort, SdoAbortedError
from pdgw.ds301.communication import LOAD_SIGNATURE, SAVE_SIGNATURE, NmtCommand
from pdgw.dsp406.kinds import LINEAR, ROTARY, Dsp406Error, EncoderDevice, multi_sensor
from pdgw.peers.encoder import Motion, SimulatedEncoderNode
from pdgw.peers.encoder.encoder_model import ENCODER_FAULTS
from pdgw.peers.encoder.motion import Follower, constant_speed, parse_motion, points, recorded, sine, still
from tests.support.drives.node_bench import NodeBench

NODE = 5
TPDO1, TPDO2 = 0x180 + NODE, 0x380 + NODE


class Bench(NodeBench[SimulatedEncoderNode]):
    """An encoder node."""

    def __init__(self, *motions: Motion, device: EncoderDevice = ROTARY, operating_time: int | None = 0) -> None:
        super().__init__(
            lambda send: SimulatedEncoderNode(
                NODE, send, device=device, motions=motions, operating_time=operating_time
            ),
            1000 * MS,
        )
        self.run(1)

    def operate(self) -> None:
        self.nmt(NmtCommand.START)

    def abort(self, index: int, value: int, subindex: int = 0) -> Abort:
        with pytest.raises(SdoAbortedError) as caught:
            self.set(index, value, subindex)
        return Abort(caught.value.code)

    def read(self, index: int, subindex: int = 0) -> int:
        entry = self.node.entry(index, subindex)
        data = self.node.get_data(index, subindex, check_readable=True)
        return int.from_bytes(data, "little", signed=entry.type.char.islower())

    def timed(self, can_id: int) -> list[tuple[int, bytes]]:
        return [(time, data) for time, identifier, data in self.frames if identifier == can_id]

    @property
    def emcy(self) -> list[tuple[int, int]]:
        return [(int.from_bytes(data[:2], "little"), data[2]) for data in self.sent(0x80 + NODE)]


# -- position, scaling, preset, speed ---------------------------------------------------------------------------------


def test_position_code_sequence_scaling_and_status() -> None:
    bench = Bench(still(1.25))
    assert bench.read(0x6004) == 5120
    bench.set(0x6000, 1)
    assert bench.read(0x6004) == 4096 * 4096 - 5120
    bench.set(0x6001, 360)
    bench.set(0x6002, 3600)
    assert bench.read(0x6004) == 4096 * 4096 - 5120  # scaling is not switched on
    bench.set(0x6000, 4)
    assert bench.read(0x6004) == 450
    assert bench.read(0x6500) == 0b110
    bench.set(0x6000, 5)
    assert bench.read(0x6004) == 3600 - 450


@given(
    st.integers(0, 7).filter(lambda value: not value & 2),
    st.integers(1, 4096),
    st.integers(1, 4096 * 4096),
    st.floats(-1e5, 1e5),
    st.data(),
)
def test_preset_then_read_gives_the_preset(
    operating: int, units: int, wanted: int, position: float, data: st.DataObject
) -> None:
    bench = Bench(still(position))
    bench.set(0x6001, units)
    bench.set(0x6002, wanted)
    bench.set(0x6000, operating)
    total = min(wanted, units * 4096) if operating & 4 else 4096 * 4096
    preset = data.draw(st.integers(0, total - 1))
    before = bench.read(0x6004)
    bench.set(0x6003, preset)
    assert bench.read(0x6004) == preset
    assert (before + bench.read(0x6509)) % total == preset
    assert bench.abort(0x6003, total) is Abort.VALUE_TOO_HIGH
    bench.nmt(NmtCommand.RESET_NODE)
    for index, value in ((0x6001, units), (0x6002, wanted), (0x6000, operating)):
        bench.set(index, value)
    assert bench.read(0x6004) == preset  # the offset is kept


def test_speed_in_measuring_units_per_second_follows_scaling_and_direction() -> None:
    bench = Bench(constant_speed(2.0))
    bench.run(50)
    assert bench.read(0x6030, 1) == 8192
    bench.set(0x6001, 360)
    bench.set(0x6000, 5)
    bench.run(50)
    assert bench.read(0x6030, 1) == -720
    bench.node.model.set_motion(constant_speed(100.0))
    bench.set(0x6000, 0)
    bench.run(50)
    assert bench.read(0x6030, 1) == 32767


@pytest.mark.parametrize(
    ("name", "values", "speed"),
    [
        ("speed-in-another-unit", {}, 82),
        ("speed-in-another-unit", {"speed_percent": 0}, 0),
    ],
)
def test_speed_of_an_encoder_outside_the_profile_has_its_own_unit(
    name: str, values: dict[str, object], speed: int
) -> None:
    bench = Bench(constant_speed(2.0))
    bench.node.start_fault(name, **values)
    bench.run(30)
    assert bench.read(0x6030, 1) == speed
    bench.node.end_fault()
    bench.run(30)
    assert bench.read(0x6030, 1) == 8192


def test_a_preset_in_motion_changes_no_speed() -> None:
    bench = Bench(constant_speed(2.0))
    bench.run(50)
    bench.set(0x6003, 0)
    bench.run(20)
    assert bench.read(0x6030, 1) == 8192


def test_linear_encoder_counts_steps_and_detects_the_end_of_its_scale() -> None:
    bench = Bench(points([(0, 100.0), (1, 110.0), (2, -10.0)]), device=LINEAR)
    bench.run(500)
    assert bench.read(0x6004) == 105 * 200
    assert bench.read(0x6030, 1) == 10  # mm/s, in steps of 1 mm/s
    bench.set(0x6005, 10, 2)
    bench.run(10)
    assert bench.read(0x6030, 1) == 100
    bench.set(0x6005, 1000, 1)
    bench.set(0x6000, 4)
    assert bench.read(0x6004) == 105
    assert bench.read(0x6400, 1) == 0
    bench.run(1600)
    assert bench.read(0x6004) == 0
    assert bench.read(0x6400, 1) == 1


def test_every_channel_of_a_multi_sensor_device_is_an_encoder_of_its_own() -> None:
    bench = Bench(still(1.0), constant_speed(-1.0), device=multi_sensor(3))
    bench.run(100)
    assert [bench.read(0x6020, n) for n in (1, 2, 3)] == [4096, 4096 * 4096 - 410, 0]
    assert [bench.read(0x6030, n) for n in (1, 2, 3)] == [0, -4096, 0]
    bench.set(0x6010, 77, 3)
    assert [bench.read(0x6020, n) for n in (1, 3)] == [4096, 77]
    assert bench.read(0x6509) == 0  # the offset of channel 1
    assert bench.abort(0x6010, 1, 4) is Abort.NO_SUCH_SUBINDEX


@pytest.mark.parametrize(
    ("index", "value", "abort"),
    [
        (0x6000, 0x0008, Abort.VALUE_RANGE),
        (0x6001, 0, Abort.VALUE_TOO_LOW),
        (0x6001, 4097, Abort.VALUE_TOO_HIGH),
        (0x6002, 0, Abort.VALUE_TOO_LOW),
        (0x6002, 4096 * 4096 + 1, Abort.VALUE_TOO_HIGH),
        (0x6003, 4096 * 4096, Abort.VALUE_TOO_HIGH),
        (0x6004, 0, Abort.READ_ONLY),
        (0x6509, 0, Abort.READ_ONLY),
    ],
)
def test_refused_values(index: int, value: int, abort: Abort) -> None:
    assert Bench().abort(index, value) is abort


# -- PDOs -------------------------------------------------------------------------------------------------------------


def test_tpdo1_is_driven_by_the_cyclic_timer_alone() -> None:
    bench = Bench(constant_speed(1.0))
    bench.operate()
    bench.run(50)
    assert bench.timed(TPDO1) == []
    bench.set(0x6200, 7)
    bench.run(70)
    times = [time for time, _ in bench.timed(TPDO1)]
    assert {b - a for a, b in pairwise(times)} == {7}
    assert len(times) == 10
    bench.set(0x6200, 0)
    bench.frames.clear()
    bench.run(50)
    assert bench.timed(TPDO1) == []


def test_late_polls_do_not_stretch_the_cyclic_timer() -> None:
    bench = Bench()
    bench.set(0x6200, 2)
    bench.operate()
    for microseconds in range(0, 100_000, 1300):
        bench.node.poll(bench.now + microseconds * 1000)
    assert len(bench.timed(TPDO1)) == pytest.approx(50, abs=1)


def test_tpdo1_with_type_255_is_sent_on_change() -> None:
    bench = Bench(points([(0, 0.0), (0.1, 0.0), (0.11, 0.001)]))
    bench.set(0x1800, 0x8000_0000 | TPDO1, 1)
    bench.set(0x1800, 255, 2)
    bench.set(0x1800, TPDO1, 1)
    bench.operate()
    bench.run(90)
    assert len(bench.timed(TPDO1)) == 1
    bench.run(100)
    assert [int.from_bytes(data, "little") for _, data in bench.timed(TPDO1)] == [0, 1, 2, 3, 4]


def test_tpdo2_is_sent_on_sync_with_the_position_of_that_moment_and_on_remote_request() -> None:
    bench = Bench(constant_speed(1.0))
    bench.operate()
    bench.now += MS // 2
    bench.node.receive(0x80, b"", bench.now)
    bench.node.receive_remote(TPDO2, bench.now + MS // 2)
    bench.node.receive_remote(TPDO1, bench.now + MS // 2)
    bench.node.receive_remote(0x123, bench.now + MS // 2)
    positions = [(can_id, int.from_bytes(data, "little")) for _, can_id, data in bench.frames[1:]]
    assert positions == [(TPDO2, 2), (TPDO2, 4), (TPDO1, 4)]
    bench.nmt(NmtCommand.STOP)
    bench.frames.clear()
    bench.node.receive_remote(TPDO2, bench.now)
    assert bench.frames == []


# -- cams and work area -----------------------------------------------------------------------------------------------


def test_cams_enable_polarity_and_area_of_a_channel() -> None:
    bench = Bench(points([(0, 0.0), (10, 10.0)]))
    bench.set(0x6301, 0b1000_0011, 1)
    bench.set(0x6302, 0b1000_0000, 1)
    for cam, low, high in ((0, 4096, 8192), (1, 4096 * 4095, 4096), (7, 0, 8191), (2, 0, 100_000)):
        bench.set(0x6310 + cam, low, 1)
        bench.set(0x6320 + cam, high, 1)
    bench.set(0x6330, 4096, 1)
    bench.set(0x6401, 2048, 1)
    bench.set(0x6402, 6144, 1)
    seen = []
    for _ in range(4):
        bench.run(1000)
        seen.append((bench.read(0x6300, 1), bench.read(0x6400, 1)))
    # 1, 2, 3 and 4 revolutions: cam 8 is inverted, cam 3 disabled, cam 1 holds one revolution longer.
    assert seen == [(0b11, 0), (0b1000_0001, 2), (0b1000_0001, 2), (0b1000_0000, 2)]


def test_a_cam_switched_off_forgets_its_hysteresis() -> None:
    bench = Bench(points([(0, 0.0), (1, 1.0)]))
    for index, value in ((0x6301, 1), (0x6320, 100), (0x6330, 5000)):
        bench.set(index, value, 1)
    bench.run(500)
    assert bench.read(0x6300, 1) == 1
    bench.set(0x6301, 0, 1)
    bench.set(0x6301, 1, 1)
    assert bench.read(0x6300, 1) == 0


# -- diagnostics ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", list(ENCODER_FAULTS))
def test_every_fault_has_its_bits_and_emcy_until_cleared(name: str) -> None:
    fault = ENCODER_FAULTS[name]
    bench = Bench()
    bench.node.model.inject(name)
    bench.node.model.inject(name)
    bench.run(1)
    assert (bench.read(0x6503), bench.read(0x6505), bench.read(0x1001)) == (
        fault.alarms,
        fault.warnings,
        fault.error_register,
    )
    assert bench.read(0x6503) & ~bench.read(0x6504) == bench.read(0x6505) & ~bench.read(0x6506) == 0
    expected = [(fault.error_code, fault.error_register)] if fault.error_code else []
    assert bench.emcy == expected
    bench.node.model.clear()
    bench.run(1)
    assert (bench.read(0x6503), bench.read(0x6505), bench.read(0x1001)) == (0, 0, 0)
    assert bench.emcy == (expected and [*expected, (0, 0)])


def test_several_causes_share_the_error_register() -> None:
    bench = Bench()
    for name in ("temperature", "input-voltage", "battery"):
        bench.node.model.inject(name)
    bench.run(1)
    assert bench.emcy == [(0x4000, 0x09), (0x3110, 0x0D)]
    assert [bench.read(0x1003, n) for n in (1, 2)] == [0x3110, 0x4000]
    assert bench.read(0x6505) == 1 << 4


def test_an_unknown_fault_is_named() -> None:
    with pytest.raises(Dsp406Error, match=r"'fire'.*position-error"):
        Bench().node.model.inject("fire")


def test_commissioning_diagnostics_find_a_defect_at_standstill() -> None:
    bench = Bench(points([(0, 0.0), (0.1, 1.0)]))
    bench.node.model.inject("sensor-defect")
    bench.set(0x6000, 2)
    bench.run(50)
    assert (bench.read(0x6503), bench.emcy) == (0, [])  # it turns
    bench.run(100)
    assert (bench.read(0x6503), bench.emcy) == (2, [(0x5000, 0x21)])
    bench.node.model.clear()
    bench.run(1)
    assert (bench.read(0x6503), bench.emcy[1:]) == (0, [(0, 0)])  # looked again: in order
    bench.node.model.inject("sensor-defect")
    bench.run(1)
    bench.set(0x6000, 0)
    assert bench.read(0x6503) == 0


def test_operating_time_counts_tenths_of_an_hour_through_resets() -> None:
    bench = Bench(operating_time=1234)
    assert bench.read(0x6508) == 1234
    bench.now += 360_000 * MS
    bench.nmt(NmtCommand.RESET_NODE)
    bench.run(1)
    assert bench.read(0x6508) == 1235
    bench = Bench(operating_time=None)
    assert bench.read(0x6508) == 0xFFFF_FFFF


def test_store_and_restore() -> None:
    bench = Bench(still(2.0))
    settings = ((0x6000, 0, 4), (0x6001, 0, 100), (0x6301, 1, 3), (0x6310, 1, 50), (0x6200, 0, 20), (0x1800, 3, 5))
    for index, subindex, value in settings:
        bench.set(index, value, subindex)
    bench.set(0x6003, 10)
    bench.nmt(NmtCommand.RESET_NODE)
    bench.run(1)
    assert [bench.read(index, subindex) for index, subindex, _ in settings] == [0] + [4096] + [0] * 4
    for index, subindex, value in settings:
        bench.set(index, value, subindex)
    bench.set(0x1010, SAVE_SIGNATURE, 1)
    bench.nmt(NmtCommand.RESET_NODE)
    bench.run(1)
    assert [bench.read(index, subindex) for index, subindex, _ in settings] == [value for *_, value in settings]
    assert bench.read(0x6004) == 10
    bench.set(0x1011, LOAD_SIGNATURE, 1)
    bench.nmt(NmtCommand.RESET_NODE)
    bench.run(1)
    assert [bench.read(index, subindex) for index, subindex, _ in settings] == [0] + [4096] + [0] * 4
    assert (bench.read(0x6004), bench.read(0x6509)) == (8192, 0)
    assert bench.abort(0x1010, LOAD_SIGNATURE, 1) is Abort.CANNOT_STORE


@given(st.integers(0, 0x7FF), st.binary(max_size=8), st.booleans())
def test_arbitrary_frames_never_raise_in_the_node(can_id: int, data: bytes, remote: bool) -> None:
    bench = Bench(constant_speed(1.0), Follower(0x181, 2, 4096.0), device=multi_sensor(2))
    bench.set(0x6200, 1)
    bench.operate()
    if remote:
        bench.node.receive_remote(can_id, bench.now)
    else:
        bench.node.receive(can_id, data, bench.now)
    bench.run(3)


# -- motions ----------------------------------------------------------------------------------------------------------


def test_an_encoder_follows_the_position_another_node_sends() -> None:
    bench = Bench(parse_motion("follow=0x184,3,4096"))
    bench.node.receive(0x184, b"\x37\x06\x01" + (-2048).to_bytes(4, "little", signed=True), bench.now)
    bench.run(1)
    assert bench.read(0x6004) == 4096 * 4096 - 2048
    bench.node.receive(0x184, b"\x37\x06\x01\x00", bench.now)
    bench.node.receive(0x185, bytes(8), bench.now)
    bench.run(1)
    assert bench.read(0x6004) == 4096 * 4096 - 2048


def test_an_encoder_follows_a_callable() -> None:
    place = [0.5]
    bench = Bench(lambda _: place[0])
    assert bench.read(0x6004) == 2048
    place[0] = 0.25
    bench.run(1)
    assert bench.read(0x6004) == 1024


def test_recorded_motion_file_is_used(tmp_path: Path) -> None:
    file = tmp_path / "motion.csv"
    file.write_text("time,position\n0,1.0\n\n0.1,2.0\n0.2,1.5\n", encoding="utf-8")
    motion = recorded(file)
    assert [motion(time * MS) for time in (0, 50, 100, 150, 999)] == pytest.approx([1.0, 1.5, 2.0, 1.75, 1.5])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,position\n", "points of a motion: 0"),
        ("0,1\n1,x\n", r"line 2: '1,x'"),
        ("0,1\n1\n", r"line 2: '1'"),
        ("0,1\n0,2\n", r"\(0\.0, 2\.0\).*after the last"),
        ("0,inf\n", "inf"),
        ("0,nan\n", "nan"),
    ],
)
def test_a_recorded_file_that_cannot_be_used_is_named(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "motion.csv"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(Dsp406Error, match=message) as caught:
        recorded(file)
    assert "motion.csv" in str(caught.value)


def test_motions_by_name(tmp_path: Path) -> None:
    assert parse_motion("still")(5) == 0
    assert parse_motion("still=-2")(5) == -2
    assert parse_motion("speed=3")(500 * MS) == 1.5
    assert parse_motion("sine=2,4")(1000 * MS) == pytest.approx(2)
    assert sine(1, 4, 10)(3000 * MS) == pytest.approx(9)
    assert parse_motion("shaft=7", shafts={7: still(3)})(0) == 3
    with pytest.raises(Dsp406Error, match=r"nowhere\.csv"):
        parse_motion(f"csv={tmp_path / 'nowhere.csv'}")


@pytest.mark.parametrize(
    "text",
    [
        *("", "speed", "speed=fast", "speed=nan", "speed=1e300", "sine=1", "sine=1,0", "csv=", "walk=3"),
        *("follow=1", "follow=0,0,1", "follow=0x181,5,1", "follow=0x181,1,0", "follow=x,1,1", "shaft=x", "shaft=2"),
    ],
)
def test_other_motions_are_refused(text: str) -> None:
    with pytest.raises(Dsp406Error):
        parse_motion(text)


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=20))
def test_any_recorded_positions_give_a_position_in_range(positions: list[float]) -> None:
    bench = Bench(points([(n / 100, position) for n, position in enumerate(positions)]))
    for _ in range(len(positions)):
        bench.run(10)
        assert 0 <= bench.read(0x6004) < 4096 * 4096
        assert math.isfinite(bench.node.model.channels[1].speed)


def test_more_motions_than_channels_and_unknown_channels_are_refused() -> None:
    with pytest.raises(Dsp406Error, match=r"2.*at most 1"):
        Bench(still(), still())
    with pytest.raises(Dsp406Error, match=r"channel: 2.*1\.\.1"):
        Bench().node.model.set_motion(still(), 2)
