"""The cyclic frame, byte for byte as scapy and tshark read it, and the sign of life in both directions."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scapy.layers.inet import IP, UDP
from scapy.layers.l2 import Ether
from scapy.utils import rdpcap, wrpcap

from pdgw.profidrive import frame as rt
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.scapy_layers import ProfidriveCyclic, bind, cyclic_frame, field_name
from pdgw.profidrive.sign_of_life import MONITORING_OFF, SignOfLife
from pdgw.profidrive.telegrams import Direction, Telegram, telegram
from tests.support.axis.strategies import axes_values
from tests.support.readers import tshark

EXAMPLE = bytes.fromhex("C001 047F 2000 80 80") + bytes(34) + bytes.fromhex("0020 35 00")


def struct_frame(
    telegrams: list[Telegram], direction: Direction, values: list[tuple[int, ...]], counter: int, status: int
) -> bytes:
    layout = rt.CSduLayout(telegrams, direction)
    frame_id = rt.FRAME_ID_TO_DEVICE if direction is Direction.SETPOINT else rt.FRAME_ID_TO_CONTROLLER
    frame = layout.new_frame(frame_id)
    for half, offset, iops, iocs, axis in zip(
        layout.halves, layout.offsets, layout.iops, layout.iocs, values, strict=True
    ):
        half.encode_into(frame, offset, axis)
        frame[iops] = rt.IOPS_GOOD
        frame[iocs] = rt.IOPS_GOOD
    rt.TRAILER.pack_into(frame, layout.trailer, counter, status, 0)
    return bytes(frame)


def test_example_of_the_transport_reference_one_axis_telegram_1() -> None:
    assert struct_frame([telegram(1)], Direction.SETPOINT, [(0x047F, 0x2000)], 0x20, 0x35) == EXAMPLE
    decoded = rt.RtFrame.decode(EXAMPLE)
    assert (decoded.frame_id, decoded.cycle_counter, decoded.data_status) == (0xC001, 0x20, 0x35)
    assert decoded.encode() == EXAMPLE


@given(
    drawn=st.one_of(
        st.tuples(st.just(direction), axes_values(direction)) for direction in (Direction.SETPOINT, Direction.ACTUAL)
    ),
    counter=st.integers(0, 0xFFFF),
    status=st.integers(0, 0xFF),
)
def test_struct_codec_and_scapy_agree_byte_for_byte(
    drawn: tuple[Direction, tuple[list[Telegram], list[tuple[int, ...]]]], counter: int, status: int
) -> None:
    direction, (telegrams, values) = drawn
    numbers = [chosen.number for chosen in telegrams]
    ours = struct_frame(telegrams, direction, values, counter, status)
    named = [chosen.half(direction).as_dict(axis) for chosen, axis in zip(telegrams, values, strict=True)]
    reference = cyclic_frame(numbers, direction, named, counter=counter, data_status=status)
    assert bytes(reference) == ours
    bind(numbers)
    pdu = IP(bytes(IP() / UDP(sport=40000, dport=rt.CYCLIC_PORT) / reference))[ProfidriveCyclic]
    assert pdu.cycleCounter == counter
    assert int(pdu.dataStatus) == status
    for index, axis in enumerate(named):
        part = pdu.data[2 * index]
        assert {name: int(getattr(part, field_name(name))) for name in axis} == axis


def test_a_capture_shows_stw1_bits_and_signal_names(tmp_path: Path) -> None:
    capture = tmp_path / "plc.pcap"
    bind([1, 9])
    setpoints = [{"STW1": 0x047F, "NSOLL_A": 0x2000}, {"STW1": 0x0C7F, "SATZANW": 0x8011, "MDI_TARPOS": -429496}]
    request = cyclic_frame([1, 9], Direction.SETPOINT, setpoints)
    answer = cyclic_frame([1, 9], Direction.ACTUAL, [{"ZSW1": 0x0637}, {"XIST_A": 429496}])
    wrpcap(
        str(capture),
        [
            Ether() / IP() / UDP(sport=40000, dport=rt.CYCLIC_PORT) / request,
            Ether() / IP() / UDP(sport=rt.CYCLIC_PORT, dport=40000) / answer,
        ],
    )
    sent, received = rdpcap(str(capture))
    assert sent[ProfidriveCyclic].data[0].STW1.ENABLE_OPERATION
    assert not sent[ProfidriveCyclic].data[0].STW1.FAULT_ACKNOWLEDGE
    assert sent[ProfidriveCyclic].data[2].STW1.START_HOMING
    assert sent[ProfidriveCyclic].data[2].MDI_TARPOS == -429496
    shown = sent.show(dump=True)
    assert "CONTROL_BY_PLC" in shown
    assert "NSOLL_A" in shown
    assert received[ProfidriveCyclic].data[2].XIST_A == 429496


@pytest.mark.tshark
@tshark.needs_tshark
def test_tshark_reads_the_same_header_fields(tmp_path: Path) -> None:
    capture = tmp_path / "plc.pcap"
    cases = [(0x0000, 0x35), (0xFFFF, 0x35), (0x1234, 0x25), (0x8000, 0x31), (0x0020, 0x34)]
    frames = [
        struct_frame([telegram(1), telegram(9)], Direction.SETPOINT, [(0x047F, -1), (0x047F,) + (0,) * 7], *case)
        for case in cases
    ]
    wrpcap(str(capture), [Ether() / IP() / UDP(sport=40000, dport=rt.CYCLIC_PORT) / frame for frame in frames])
    status = [f"pn_rt.ds_{name}" for name in ("primary", "valid", "operate", "ok")]
    rows = tshark.fields(
        capture, ["pn_rt.frame_id", "pn_rt.cycle_counter", "pn_rt.ds", "pn_rt.transfer_status", *status]
    )
    assert len(rows) == len(cases)
    for row, (counter, data_status) in zip(rows, cases, strict=True):
        assert int(row["pn_rt.frame_id"], 0) == rt.FRAME_ID_TO_DEVICE
        assert int(row["pn_rt.cycle_counter"], 0) == counter
        assert int(row["pn_rt.ds"], 0) == data_status
        assert int(row["pn_rt.transfer_status"], 0) == 0
        bits = (rt.STATUS_PRIMARY, rt.STATUS_DATA_VALID, rt.STATUS_RUN, rt.STATUS_NO_PROBLEM)
        for name, bit in zip(status, bits, strict=True):
            assert int(row[name], 0) == bool(data_status & bit)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (EXAMPLE[:-1], "RT frame length: 45"),
        (b"", "RT frame length: 0"),
        (bytes(1500), "RT frame length: 1500"),
        (b"\x80\x00" + EXAMPLE[2:], "FrameID: '8000h'"),
        (b"\xfe\xfd" + EXAMPLE[2:], "FrameID: 'FEFDh'"),
    ],
)
def test_what_is_not_a_cyclic_frame_is_refused_by_field(data: bytes, message: str) -> None:
    with pytest.raises(ProfidriveError, match=message):
        rt.RtFrame.decode(data)


@given(data=st.binary(max_size=80))
def test_arbitrary_bytes_decode_or_raise_the_packages_error(data: bytes) -> None:
    with contextlib.suppress(ProfidriveError):
        assert rt.RtFrame.decode(data).encode() == data


@pytest.mark.parametrize(
    ("new", "last", "newer"),
    [(1, 0, True), (0, 0, False), (0, 0xFFFF, True), (61440, 0, True), (61441, 0, False), (0xFFFF, 0, False)],
)
def test_a_frame_is_newer_within_61440_steps(new: int, last: int, newer: bool) -> None:
    assert rt.is_newer(new, last) is newer


def test_several_axes_follow_one_another_with_iocs_at_the_end() -> None:
    layout = rt.CSduLayout([telegram(1), telegram(9)], Direction.SETPOINT)
    assert layout.offsets == (2, 7)
    assert layout.iops == (6, 27)
    assert layout.iocs == (28, 29)
    assert layout.frame_size == 46


def test_too_many_axes_for_one_frame_are_refused() -> None:
    with pytest.raises(ProfidriveError, match="C_SDU length"):
        rt.CSduLayout([telegram(100)] * 40, Direction.SETPOINT)
    with pytest.raises(ProfidriveError, match="axes of a frame"):
        rt.CSduLayout([], Direction.ACTUAL)


# -- sign of life -----------------------------------------------------------------------------------------------------


def test_the_own_counter_runs_1_to_15_without_0() -> None:
    life = SignOfLife(0)
    received = [(start + 7) % 15 + 1 for start in range(40)]
    assert [life.step(counter) for counter in received] == [cycle % 15 + 1 for cycle in range(40)]
    assert not life.failed


def test_controller_without_sign_of_life_is_neither_monitored_nor_answered() -> None:
    life = SignOfLife(0)
    assert [life.step(0) for _ in range(20)] == [0] * 20
    assert not life.failed


@pytest.mark.parametrize("tolerated", [0, 1, 5, 14, 15, 16, 100])
@pytest.mark.parametrize("stuck", [0, 3])
def test_more_failures_than_tolerated_are_an_error(tolerated: int, stuck: int) -> None:
    life = SignOfLife(tolerated)
    life.step(3)
    for _ in range(tolerated):
        life.step(stuck)
        assert not life.failed
    assert life.step(stuck) == 0
    assert life.failed


def test_65535_switches_the_monitoring_off() -> None:
    life = SignOfLife(MONITORING_OFF)
    life.step(3)
    assert [life.step(3) for _ in range(16)] == [cycle % 15 + 1 for cycle in range(1, 17)]
    assert not life.failed


def test_a_lost_frame_is_one_failure() -> None:
    life = SignOfLife(1)
    for counter in (4, 4, 6, 7, 7, 9):
        life.step(counter)
        assert not life.failed
    assert life.failures == 0


def test_lost_controller_returns_after_15_correct_counters() -> None:
    life = SignOfLife(0)
    for counter in (4, 5, 11):
        life.step(counter)
    assert [life.step(counter) for counter in (12, 13, 14, 15, *range(1, 12))] == [0] * 14 + [1]
    assert not life.failed


@pytest.mark.parametrize("tolerated", [0, 3])
def test_controller_that_counts_too_slowly_is_lost_once(tolerated: int) -> None:
    life, losses, failed = SignOfLife(tolerated), 0, False
    for frame in range(1000):
        life.step(frame // 8 % 15 + 1)
        losses += life.failed and not failed
        failed = life.failed
    assert failed
    assert losses == 1


@given(st.lists(st.integers(0, 15)), st.integers(0, 20))
def test_no_failure_while_the_last_counter_is_correct(counters: list[int], tolerated: int) -> None:
    life = SignOfLife(tolerated)
    for counter in counters:
        own = life.step(counter)
        assert 0 <= own <= 15
        assert life.failed == (life.failures > tolerated)


@pytest.mark.parametrize("tolerated", [-1, 65536])
def test_p925_is_a_word(tolerated: int) -> None:
    with pytest.raises(ProfidriveError, match="P925"):
        SignOfLife(tolerated)


@pytest.mark.parametrize("counter", [-1, 16])
def test_a_counter_has_four_bits(counter: int) -> None:
    with pytest.raises(ProfidriveError, match="sign of life"):
        SignOfLife(0).step(counter)
