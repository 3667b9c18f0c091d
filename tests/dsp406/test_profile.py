"""The catalogue against tables copied from CiA DSP 406 V2.0, and the chain from position to output, speed, cams and work area."""

from __future__ import annotations

import canopen
import pytest
from canopen.objectdictionary import ODVariable
from hypothesis import given
from hypothesis import strategies as st

from pdgw.ds301.eds.writer import write_eds
from pdgw.ds301.objects import Access, CanType, Catalogue, ObjectKind
from pdgw.dsp406.device import device_info, eds_path, encoder_objects
from pdgw.dsp406.faults import ENCODER_EMCY
from pdgw.dsp406.kinds import (
    DEVICES,
    LINEAR,
    MULTI_SENSOR,
    OPERATING_RESERVED,
    ROTARY,
    Alarm,
    Dsp406Error,
    EncoderDevice,
    EncoderType,
    Operating,
    Warnings,
    multi_sensor,
)
from pdgw.dsp406.objects import PROFILE, Category, EncoderClass, encoder_catalogue
from pdgw.peers.encoder.outputs import AreaState, Chain, area_state, cam_active, cam_state, chain, speed_value

ALL = tuple(DEVICES.values())
CHANNELS = multi_sensor(3)

OVERVIEW = """
6000 VAR   U16 rw m/o m/o Operating parameters
6001 VAR   U32 rw  -  m   Measuring units per revolution
6002 VAR   U32 rw  -  m   Total measuring range in measuring units
6003 VAR   U32 rw  -  m   Preset value
6004 VAR   U32 ro  m  m   Position value
6005 REC   U32 rw  -  m   Linear encoder measuring step settings
6010 ARRAY U32 rw  -  m   Preset value for multi-sensor devices
6020 ARRAY I32 ro  m  m   Position value for multi-sensor devices
6030 ARRAY I16 ro  -  m   Speed value
6200 VAR   U16 rw  -  m   Cyclic timer
6300 ARRAY U8  ro  o  o   Cam state register
6301 ARRAY U8  rw  o  o   Cam enable register
6302 ARRAY U8  rw  o  o   Cam polarity register
6400 ARRAY U8  ro  o  o   Area state register
6401 ARRAY I32 rw  o  o   Work area low limit
6402 ARRAY I32 rw  o  o   Work area high limit
6500 VAR   U16 ro  m  m   Operating status
6501 VAR   U32 ro  m  m   SingleTurn resolution (rotary), Measuring step (linear)
6502 VAR   U16 ro  m  m   Number of distinguishable revolutions
6503 VAR   U16 ro  m  m   Alarms
6504 VAR   U16 ro  m  m   Supported alarms
6505 VAR   U16 ro  m  m   Warnings
6506 VAR   U16 ro  m  m   Supported Warnings
6507 VAR   U32 ro  -  m   Profile and software version
6508 VAR   U32 ro  -  m   Operating time
6509 VAR   I32 ro  -  m   Offset value
650A REC   I32 ro  -  m   Module identification
650B VAR   U32 ro  -  m   Serial number
"""
"""Chapter 8: index, object, data length, attribute, C1, C2, name. 6010h and 6020h are printed VAR there, ARRAY in 8.1.7/8.1.8.
m/o is mandatory, with optional functions (chapter 8.1.1)."""

CAMS = [
    *((0x6310 + n, f"Cam {n + 1} low limit", "I32") for n in range(8)),
    *((0x6320 + n, f"Cam {n + 1} high limit", "I32") for n in range(8)),
    *((0x6330 + n, f"Cam {n + 1} hysteresis", "U16") for n in range(8)),
]
"""Chapters 8.2.4 to 8.2.27."""

PDO_MAPPING_YES = {0x6004, 0x6020, 0x6030, 0x6300, 0x6301, 0x6302, 0x6400}
KINDS = {"VAR": ObjectKind.VAR, "REC": ObjectKind.RECORD, "ARRAY": ObjectKind.ARRAY}
ONLY = {0x6003: "single", 0x6004: "single", 0x6005: "linear", 0x6010: "multi", 0x6020: "multi"}
"""Objects that the text gives to linear or to multi-sensor encoders only, and their counterparts."""


def overview() -> list[tuple[int, str, str, str, str, str, str]]:
    rows = [line.split(None, 6) for line in OVERVIEW.strip().splitlines()]
    table = [(int(row[0], 16), *row[1:]) for row in rows]
    table += [(index, "ARRAY", type_, "rw", "o", "o", name) for index, name, type_ in CAMS]
    return sorted(table)  # type: ignore[return-value,arg-type]


def _plain(name: str) -> str:
    return name.lower().replace("single-turn", "singleturn").replace("values", "value")


def _has(device: EncoderDevice, index: int) -> bool:
    groups = {"multi" if device.type == 10 else "single", "linear" if device.type == 8 else "rotary"}
    return ONLY.get(index) in {None, *groups}


def test_the_overview_names_every_object_and_no_other() -> None:
    assert [row.index for row in PROFILE] == [row[0] for row in overview()]


@pytest.mark.parametrize("row", overview(), ids=lambda row: f"{row[0]:04X}h {row[6]}")
def test_each_row_of_the_overview(row: tuple[int, str, str, str, str, str, str]) -> None:
    index, kind, type_, access, c1, c2, name = row
    (declared,) = [item for item in PROFILE if item.index == index]
    assert _plain(declared.name).split(",")[0] == _plain(name).split(" (")[0].split(",")[0]
    assert declared.type is CanType[type_]
    assert declared.access is Access(access)
    assert declared.pdo == (index in PDO_MAPPING_YES)
    assert (declared.c1.value or "-", declared.c2.value or "-") == (c1[0], c2[0])
    for device in (ROTARY, LINEAR, CHANNELS):
        specs = {spec.index: spec for spec in encoder_catalogue(device).objects}
        assert (index in specs) == _has(device, index), device.name
        if index in specs:
            assert specs[index].kind is KINDS[kind]
            entries = [entry for entry in specs[index].entries if entry.subindex or kind == "VAR"]
            subs = {"VAR": [0], "ARRAY": list(range(1, device.channels + 1))}
            subs["REC"] = [1, 2] if index == 0x6005 else [1, 2, 3]
            assert [entry.subindex for entry in entries] == subs[kind]
            for entry in entries:
                assert (entry.type, entry.access, entry.pdo) == (declared.type, declared.access, declared.pdo)


@pytest.mark.parametrize("device", [*ALL, CHANNELS, multi_sensor(254)], ids=lambda d: f"{d.name} {d.channels}")
def test_sub_index_0_counts_the_channels(device: EncoderDevice) -> None:
    for spec in encoder_catalogue(device).objects:
        if spec.kind is ObjectKind.ARRAY:
            assert spec.entries[0].default == device.channels
            assert spec.entries[0].type is CanType.U8


@pytest.mark.parametrize("device", ALL, ids=lambda device: device.name)
def test_objects_required_by_a_class_exist(device: EncoderDevice) -> None:
    there = {spec.index for spec in encoder_objects(device)}
    for encoder_class in EncoderClass:
        demanded = {row.index for row in PROFILE if row.category(encoder_class, device.type) is Category.MANDATORY}
        assert demanded <= there
    assert {0x1000, 0x1001, 0x1010} <= there  # chapter 7.3


def test_categories_of_the_special_encoders() -> None:
    speed = next(row for row in PROFILE if row.index == 0x6030)
    assert speed.category(EncoderClass.C2, EncoderType.MULTI_SENSOR) is Category.MANDATORY
    assert speed.category(EncoderClass.C2, EncoderType.MULTI_TURN) is Category.OPTIONAL
    assert speed.category(EncoderClass.C1, EncoderType.MULTI_SENSOR) is Category.NONE
    steps = next(row for row in PROFILE if row.index == 0x6005)
    assert [t.value for t in EncoderType if steps.category(EncoderClass.C2, t) is Category.MANDATORY] == [6, 7, 8, 9]


def test_encoder_types_of_the_device_type() -> None:
    """Chapter 7.4."""
    assert [t.value for t in EncoderType] == list(range(1, 11))
    assert [device.device_type for device in ALL] == [0x0002_0196, 0x0008_0196, 0x000A_0196]


def _bits(flag: type[Operating] | type[Alarm] | type[Warnings] | type[AreaState]) -> dict[int, str]:
    return {bit.value.bit_length() - 1: (bit.name or "").lower().replace("_", " ") for bit in flag}


def test_bit_tables() -> None:
    """Chapters 8.1.1, 8.3.1, 8.4.4 and 8.4.6."""
    assert _bits(Operating) == {0: "counterclockwise", 1: "commissioning diagnostics", 2: "scaling"}
    assert sum(1 << bit for bit in range(3, 12)) == OPERATING_RESERVED
    assert _bits(Alarm) == {0: "position error", 1: "commissioning diagnostics"}
    assert _bits(Warnings) == {
        0: "frequency exceeded",
        1: "light control reserve",
        2: "cpu watchdog",
        3: "operating time",
        4: "battery charge",
        5: "reference point",
    }
    assert _bits(AreaState) == {0: "out of range", 1: "overflow", 2: "underflow"}


def test_emergency_error_codes() -> None:
    """Chapter 6.2."""
    codes = "0000 1000 2000 2100 2110 3000 3100 3110 4000 5000 5100 6000 7000 8000 9000 F000 FFFF"
    assert [f"{code:04X}" for code in ENCODER_EMCY] == codes.split()
    assert ENCODER_EMCY[0x2110] == "input current too high"
    assert ENCODER_EMCY[0x3110] == "input voltage out of range"
    assert ENCODER_EMCY[0x5100] == "hardware memory error"


@pytest.mark.parametrize("device", ALL, ids=lambda device: device.name)
def test_default_pdos(device: EncoderDevice) -> None:
    """Chapters 7.1 and 7.2; sub-index 3 is the last."""
    mapping = 0x6020_0120 if device.type == 10 else 0x6004_0020
    specs = {spec.index: spec for spec in encoder_objects(device)}
    for communication, type_ in ((0x1800, 254), (0x1802, 1)):
        defaults = [entry.default for entry in specs[communication].entries]
        assert (defaults[0], defaults[2], defaults[3], len(defaults)) == (3, type_, 0, 4)
        assert [entry.default for entry in specs[communication + 0x200].entries][:2] == [1, mapping]
    assert {index for index in specs if 0x1400 <= index < 0x1800} == set()


def _value(catalogue: Catalogue, index: int, subindex: int = 0) -> object:
    return catalogue.entry(index, subindex).default


def test_values_of_the_diagnostics() -> None:
    """Chapter 8.4: measuring range = revolutions * resolution; a measuring step of 1 mm is 3E8h; version 1.40 is 0140h."""
    for device in ALL:
        catalogue = encoder_catalogue(device, 77)
        assert _value(catalogue, 0x6504) == 0x0003
        assert _value(catalogue, 0x6506) == 0x003F
        assert _value(catalogue, 0x6507) == 0x0100_0200
        assert _value(catalogue, 0x650B) == 77
        assert _value(catalogue, 0x650A, 3) == device.steps - 1
    assert _value(encoder_catalogue(ROTARY), 0x6002) == 4096 * 4096
    assert LINEAR.steps_per_unit == 200  # 5 um
    assert EncoderDevice("coarse", EncoderType.LINEAR, 1, 0x3E8, length=10).steps_per_unit == 1


@pytest.mark.parametrize("device", ALL, ids=lambda device: device.name)
def test_the_eds_in_the_package_is_the_declared_device_and_canopen_reads_it(device: EncoderDevice) -> None:
    assert eds_path(device).read_text(encoding="ascii") == write_eds(device_info(device), encoder_objects(device)), (
        "run: make docs"
    )
    dictionary = canopen.import_od(str(eds_path(device)), 5)
    assert not dictionary.device_information.nr_of_RXPDO
    for spec in encoder_objects(device):
        for entry in spec.entries:
            variable = dictionary.get_variable(entry.index, entry.subindex)
            assert isinstance(variable, ODVariable)
            assert variable.data_type == entry.type.code
            assert variable.access_type == entry.access.value
            assert bool(variable.pdo_mappable) == entry.pdo
    assert dictionary[0x1802][1].default == 0x385


def test_impossible_devices_are_refused() -> None:
    for change in ({"channels": 2}, {"resolution": 0}, {"turns": 65536}, {"resolution": 1 << 20}):
        values: dict[str, int] = {"resolution": 4096, "turns": 4096, **change}
        with pytest.raises(Dsp406Error, match=r"rotary encoder: .* is not allowed, expected 1"):
            EncoderDevice("rotary", EncoderType.MULTI_TURN, 1, **values)
    with pytest.raises(Dsp406Error, match=r"channels .* 255 .* 1\.\.254"):
        multi_sensor(255)
    assert MULTI_SENSOR.channels == 2


# -- from the physical position to the output -------------------------------------------------------------------------


RANGE = 4096 * 16
PHYSICAL = st.integers(-(10**9), 10**9)
CHAINS = st.builds(Chain, st.booleans(), st.integers(1, 4096), st.integers(1, 4096), st.integers(1, 1 << 32))


@given(CHAINS, PHYSICAL, st.data())
def test_preset_then_read_gives_the_preset_and_the_offset_fits_6509h(
    chain: Chain, physical: int, data: st.DataObject
) -> None:
    preset = data.draw(st.integers(0, chain.total_range - 1))
    offset = chain.offset_for(physical, preset)
    assert chain.output(physical, offset) == preset
    assert -(1 << 31) <= offset < 1 << 31


@given(CHAINS, PHYSICAL, st.integers(0, 10**6), st.integers(-(1 << 31), (1 << 31) - 1))
def test_scaling_is_monotone_and_the_output_wraps_at_the_total_range(
    chain: Chain, physical: int, step: int, offset: int
) -> None:
    before, after = chain.scaled(physical), chain.scaled(physical + step)
    assert (before - after if chain.counterclockwise else after - before) >= 0
    assert 0 <= chain.output(physical, offset) < chain.total_range
    assert (chain.output(physical + step, offset) - chain.output(physical, offset) - (after - before)) % (
        chain.total_range
    ) == 0


@given(st.integers(1, 4096), st.integers(1, 4096), PHYSICAL)
def test_a_whole_turn_is_the_units_per_revolution_whatever_the_resolution(units: int, turns: int, turn: int) -> None:
    rotary = chain(
        counterclockwise=False,
        scaling=True,
        numerator=units,
        denominator=4096,
        total_range=1 << 32,
        steps=4096 * turns,
    )
    assert rotary.total_range == units * turns
    assert rotary.output(turn * 4096, 0) == turn * units % (units * turns)


def test_the_chain_of_the_parameters() -> None:
    unscaled = chain(
        counterclockwise=True, scaling=False, numerator=360, denominator=4096, total_range=3600, steps=RANGE
    )
    assert unscaled == Chain(True, 1, 1, RANGE)
    assert [unscaled.output(step, 0) for step in (0, 1, 2)] == [0, RANGE - 1, RANGE - 2]
    scaled = chain(counterclockwise=False, scaling=True, numerator=360, denominator=4096, total_range=3600, steps=RANGE)
    assert scaled.total_range == 3600
    assert [scaled.output(4096 * turn, 0) for turn in (1, 9, 10, 11)] == [360, 3240, 0, 360]
    assert scaled.output(-1, 0) == 3599
    assert scaled.output(2048, 0) == 180
    small = chain(counterclockwise=False, scaling=True, numerator=1, denominator=4096, total_range=9999, steps=4096)
    assert small.total_range == 1  # a range the hardware does not have is not reached


@pytest.mark.parametrize(("speed", "shown"), [(0.4, 0), (-1.6, -2), (40000.0, 32767), (-40000.0, -32768)])
def test_the_speed_object_saturates(speed: float, shown: int) -> None:
    assert speed_value(speed) == shown


@given(CHAINS, st.floats(-1e6, 1e6))
def test_the_speed_has_the_sign_of_the_growing_position(chain: Chain, speed: float) -> None:
    expected = speed * chain.numerator / chain.denominator
    assert chain.speed(speed) == (-expected if chain.counterclockwise else expected)


class PlainCam:
    """A cam as an engineer would draw it: the set of positions where it switches on, and where it then stays on."""

    def __init__(self, low: int, high: int, hysteresis: int, size: int) -> None:
        inside = {p for p in range(size) if (low <= p <= high if low <= high else not high < p < low)}
        self.on = inside
        self.stay = {(p + d) % size for p in inside for d in range(-hysteresis, hysteresis + 1)}
        self.active = False

    def at(self, position: int) -> bool:
        self.active = position in self.on or (self.active and position in self.stay)
        return self.active


_SMALL = st.integers(0, 39)


@given(_SMALL, _SMALL, st.integers(0, 50), st.lists(_SMALL, min_size=1, max_size=60))
def test_a_cam_is_the_plain_model_over_random_positions(
    low: int, high: int, hysteresis: int, positions: list[int]
) -> None:
    plain = PlainCam(low, high, hysteresis, 40)
    active = False
    for position in positions:
        active = cam_active(position, low, high, hysteresis, active, 40)
        assert active == plain.at(position), position


def test_hysteresis_acts_on_both_edges() -> None:
    way = [9, 10, 20, 23, 24, 23, 20, 10, 7, 6, 7, 10]
    active, seen = False, []
    for position in way:
        active = cam_active(position, 10, 20, 3, active, 1000)
        seen.append(active)
    assert seen == [False, True, True, True, False, False, True, True, True, False, False, True]


@given(st.integers(0, 255), st.integers(0, 255), st.integers(0, 255))
def test_polarity_inverts_and_disabled_cams_read_0(active: int, enable: int, polarity: int) -> None:
    state = cam_state(active, enable, polarity)
    for cam in range(8):
        bit = 1 << cam
        expected = bool(enable & bit) and bool(active & bit) != bool(polarity & bit)
        assert bool(state & bit) == expected


@pytest.mark.parametrize(
    ("position", "low", "high", "state"),
    [
        (9, 10, 20, AreaState.UNDERFLOW),
        (10, 10, 20, AreaState(0)),
        (20, 10, 20, AreaState(0)),
        (21, 10, 20, AreaState.OVERFLOW),
        (21, 20, 10, AreaState(0)),
        (9, 20, 10, AreaState(0)),
        (15, 20, 10, AreaState.OVERFLOW | AreaState.UNDERFLOW),
        (0, -5, 5, AreaState(0)),
    ],
)
def test_work_area(position: int, low: int, high: int, state: AreaState) -> None:
    assert area_state(position, low, high, out_of_range=False) == state
    assert area_state(position, low, high, out_of_range=True) == state | AreaState.OUT_OF_RANGE
