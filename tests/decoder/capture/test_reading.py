"""Filters, columns, changes and statistics over decoded packets."""

from __future__ import annotations

import itertools
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.ds301.bus.load import frame_bits
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.frame import STATUS_NORMAL
from pdgw.profidrive.telegrams import Direction, telegram
from pdgw.tools.decoder.frames.engine import CanPacket, Decoder, Packet, Settings, given_axes
from pdgw.tools.decoder.frames.link import CanFrame
from pdgw.tools.decoder.frames.records import LinkType, Record
from pdgw.tools.decoder.view.filter import Changes, Filter, Selection
from pdgw.tools.decoder.view.names import RECORD_NAMES, Names
from pdgw.tools.decoder.view.render import Columns
from pdgw.tools.decoder.view.statistics import Statistics
from tests.decoder.frames.profinet.test_cyclic import frame

NAMES = Names()


def setpoint(stw1: int, speed: int, *, target: int = 0, counter: int = 0, time_ns: int = 0) -> Packet:
    """A frame of two axes, telegrams 1 and 9, as EtherType 8892h."""
    values = [(stw1, speed), (0, 0, 0, target, 0, 0, 0, 0)]
    rt = frame([telegram(1), telegram(9)], Direction.SETPOINT, values, counter=counter, status=STATUS_NORMAL)
    return Packet(1, time_ns, LinkType.ETHERNET, "eth0", bytes(12) + b"\x88\x92" + rt)


def can(cob_id: int, data: bytes, time_ns: int = 0) -> CanPacket:
    return CanPacket(1, time_ns, "can0", CanFrame(cob_id, data))


def decoder() -> Decoder:
    return Decoder(Settings(given_axes([1, 9])))


def one(packet: Packet | CanPacket) -> Record:
    return decoder().decode(packet)


FRAME = one(setpoint(0x047F, 0x2000, target=-(1 << 29)))
STATUS = one(can(0x181, struct.pack("<Hi", 0x0237, -5)))
HEARTBEAT = one(can(0x702, b"\x05"))
ABORT = one(can(0x581, bytes.fromhex("8040600030000906")))


@pytest.mark.parametrize(
    ("text", "record", "axes"),
    [
        ("stw1.on == 1 and axis == 1", FRAME, [1]),
        ("STW1.On == 0 and Axis == 1", FRAME, None),
        ("stw1.on == 0", FRAME, [2]),
        ("nsoll_a == 50", FRAME, [1]),
        ("mdi_tarpos < -49.9", FRAME, [2]),
        ("stw1 & 0x0F == 0xF", FRAME, [1]),
        ("stw1 >> 10 == 1", FRAME, [1]),
        ("telegram in (9, 100)", FRAME, [2]),
        ("kind == 'FRAME'", FRAME, [1, 2]),
        ("frame_id == 0xC001 and direction == 'setpoint'", FRAME, [1, 2]),
        ("-10 < velocity_actual_value < 0", STATUS, [1]),
        ("statusword.text == 'operation enabled'", STATUS, [1]),
        ("statusword.operation_enabled", STATUS, [1]),
        ("not statusword.operation_enabled", STATUS, None),
        ("node == 2 and state == 5", HEARTBEAT, []),
        ("bus == 'can' and state != 5", HEARTBEAT, None),
        ("abort == 0x06090030 and object == 'Controlword' and index == 0x6040", ABORT, []),
    ],
)
def test_filters(text: str, record: Record, axes: list[int] | None) -> None:
    units = Filter(text, NAMES).select(record)
    assert (None if units is None else [unit.axis for unit in units]) == axes


@pytest.mark.parametrize(
    "text", ["stw1 == 0", "not stw1 == 0", "stw1 != 0", "not stw1", "stw1.on in (0, 1)", "stw1 + 1"]
)
def test_filter_on_a_missing_field_is_never_true(text: str) -> None:
    assert Filter(text, NAMES).select(HEARTBEAT) is None
    assert Filter(f"node == 2 or ({text})", NAMES).select(HEARTBEAT) == ()
    assert Filter(f"node == 3 or ({text})", NAMES).select(HEARTBEAT) is None
    assert Filter(f"not (node == 3 and ({text}))", NAMES).select(HEARTBEAT) == ()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("stw3 == 1", "name: 'stw3'.*stw1"),
        ("stw1.onn == 1", "part of stw1: 'onn'.*on"),
        ("axis.x == 1", "axis alone"),
        ("stw1 = 1", "filter at column"),
        ("stw1 ==", "filter at column"),
        ("__import__('os').system('true')", "filter at column 1"),
        ("(lambda: 1)()", "filter at column 1"),
        ("stw1 ** 2 > 1", "filter at column 1"),
        ("'a' * 1000000000", "numbers in an arithmetic operation"),
        ("axis in 1", "a list after in"),
        ("1 << 1000 > 1", "a shift by 0 to 64"),
        ("axis / 0 == 1", "division by zero"),
        ("kind < 3", "'frame' and 3"),
        ("[x for x in (1,)]", "filter at column 1"),
        ("(" * 3000 + "1" + ")" * 3000, "at most 2000"),
        ("(" * 900 + "1" + ")" * 900, "filter"),
        ("-" * 1500 + "1", "filter"),
        ("", "filter"),
        ("stw1.on.x", "filter at column 1"),
        ("f'{axis}'", "filter at column 1"),
    ],
)
def test_bad_filters_are_rejected_with_the_error(text: str, message: str) -> None:
    with pytest.raises(ProfidriveError, match=message):
        Filter(text, NAMES).select(FRAME)


@given(text=st.text(alphabet="stw1. on=<>andornot()'0123456789&|~+-*/%[],_axis", max_size=40))
def test_any_text_is_a_filter_or_rejected(text: str) -> None:
    try:
        Filter(text, NAMES).select(FRAME)
    except ProfidriveError:
        return


TITLES = st.lists(
    st.sampled_from([*RECORD_NAMES, "STW1", "stw1.on", "NSOLL_A", "MDI_TARPOS", "Statusword", "statusword.text"]),
    min_size=1,
    max_size=6,
)


@given(
    titles=TITLES,
    words=st.lists(st.tuples(st.integers(0, 0xFFFF), st.integers(-0x8000, 0x7FFF)), min_size=1, max_size=5),
)
def test_rows_from_whole_frames_are_those_of_the_units(titles: list[str], words: list[tuple[int, int]]) -> None:
    follow = decoder()
    columns = Columns(titles, NAMES)
    for word, value in words:
        for packet in (setpoint(word, value), can(0x181, struct.pack("<Hi", word, value)), can(0x701, b"\x05")):
            record = follow.decode(packet)
            straight = [row for _, row in columns.rows(record)]
            assert straight == [row for _, row in columns.unit_rows(record, record.units)]
            assert all(len(row) == len(titles) for row in straight)


def test_unknown_column_is_rejected() -> None:
    with pytest.raises(ProfidriveError, match=r"'nsol_a'.*nsoll_a"):
        Columns(["nsol_a"], NAMES)


def test_changes_show_only_the_signals_that_changed() -> None:
    follow, changes = decoder(), Changes()
    shown = []
    for packet in (
        setpoint(0x047E, 0),
        setpoint(0x047E, 0, counter=32),
        setpoint(0x047F, 0),
        setpoint(0x047F, 5, target=1),
        can(0x701, b"\x05"),
        can(0x701, b"\x05"),
        can(0x701, b"\x7f"),
        can(0x80, b""),
        can(0x80, b""),
    ):
        record = follow.decode(packet)
        units = changes.select(record, record.units)
        shown.append(
            None
            if units is None
            else [(u.axis, {f.name: raw for f, raw in u.items()}) for u in units if len(u.values) < 8]
        )
    assert shown == [
        [(1, {"STW1": 0x047E, "NSOLL_A": 0})],
        None,
        [(1, {"STW1": 0x047F})],
        [(1, {"NSOLL_A": 5}), (2, {"MDI_TARPOS": 1})],
        [],
        None,
        [],
        [],
        None,
    ]


def test_changes_of_status_or_unknown_bytes_are_shown() -> None:
    follow, changes = decoder(), Changes()

    def shown(packet: Packet | CanPacket) -> bool:
        record = follow.decode(packet)
        return changes.select(record, record.units) is not None

    stop = setpoint(1, 2)._replace(data=setpoint(1, 2).data[:-2] + b"\x25\0")
    assert [shown(packet) for packet in (setpoint(1, 2), setpoint(1, 2, counter=9), stop, stop, setpoint(1, 2))] == [
        *(True, False, True, False, True)
    ]
    unknown = [can(0x485, data) for data in (b"\1", b"\1", b"\2")]
    assert [shown(packet) for packet in unknown] == [True, False, True]
    emcy = can(0x81, bytes(8))
    assert [shown(emcy), shown(emcy)] == [True, True]


def test_selection_by_time_node_and_signal() -> None:
    records = [one(setpoint(1, 2, time_ns=10)), one(can(0x181, bytes(6), 20)), one(can(0x702, b"\x05", 30))]
    selections = {
        "time": Selection(begin_ns=15, end_ns=25),
        "node": Selection(filter=Filter("node == 2", Names())),
        "signal": Selection(signals=["nsoll_a", "statusword"]),
    }
    shown = {name: [s.select(record) for record in records] for name, s in selections.items()}
    assert [units is not None for units in shown["time"]] == [False, True, False]
    node = shown["node"]
    assert node[0] is not None
    assert [unit.axis for unit in node[0]] == [2]
    assert node[1:] == [None, ()]
    signals = [[f.name for unit in units or () for f, _ in unit.items()] for units in shown["signal"]]
    assert signals == [["NSOLL_A"], ["Statusword"], []]


def test_statistics_find_gaps_stale_frames_jitter_and_load() -> None:
    follow, statistics = decoder(), Statistics()
    times = [0, 4, 8, 13, 24, 28]
    for time_ms, counter in zip(times, (0, 128, 256, 384, 768, 768), strict=True):
        statistics.add(follow.decode(setpoint(0, 0, counter=counter, time_ns=time_ms * 1_000_000)))
    for time_ms in range(0, 29, 2):
        statistics.add(follow.decode(can(0x181, bytes(6), time_ms * 1_000_000)))
    document = statistics.document(1_000_000)
    plc, tpdo = document["streams"]
    assert (plc["identifier"], plc["packets"]) == ("C001h", 6)
    assert (plc["counter_step_us"], plc["counter_gaps"], plc["missing_frames"], plc["stale_frames"]) == (4000, 1, 2, 1)
    assert (plc["interval_min_us"], plc["interval_max_us"]) == (4000, 11000)
    intervals = [b - a for a, b in itertools.pairwise(times)]
    mean = sum(intervals) / len(intervals)
    deviation = (sum((i - mean) ** 2 for i in intervals) / len(intervals)) ** 0.5
    assert plc["jitter_us"] == pytest.approx(1000 * deviation)
    assert tpdo["rate_per_s"] == pytest.approx(500)
    assert tpdo["load"] == pytest.approx(15 * frame_bits(6, worst=False) / 28_000)
    assert tpdo["load_worst"] == pytest.approx(15 * frame_bits(6) / 28_000)


def test_the_counter_wraps_without_a_gap() -> None:
    follow, statistics = decoder(), Statistics()
    for number in range(10):
        packet = setpoint(0, 0, counter=65536 - 300 + 128 * number & 0xFFFF, time_ns=number)
        statistics.add(follow.decode(packet))
    (stream,) = statistics.streams
    assert (stream.counters.gaps, stream.counters.stale, stream.counters.step) == (0, 0, 128)
