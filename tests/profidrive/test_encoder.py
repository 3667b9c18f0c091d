"""Sensor interface, STW2_ENC/ZSW2_ENC: every transition against a plain model, positions against a plain encoder."""

from __future__ import annotations

import copy
import itertools
import random
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.base.durations import MS
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.encoder import (
    PARKED_NS,
    PRESET_EFFECT_NS,
    EncoderControl,
    PresetRequest,
    SensorInterface,
    rotary_speed_reference,
    speed_normalisation,
)
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.sensor_states import SENSOR_STATUS, TRANSITIONS, SensorError, SensorEvent, SensorState
from pdgw.profidrive.sign_of_life import MONITORING_OFF, SignOfLife
from tests.support.documents.profile_oracle import SENSOR_SHOWN, sensor_state

ACKNOWLEDGE, PARK, ABSOLUTE, PRESET, RELATIVE = 0x8000, 0x4000, 0x2000, 0x1000, 0x0800
ERROR = 0x8000
RANGE = 1000

# -- the handshake ----------------------------------------------------------------------------------------------------

STATUS = {SensorState[name]: word for name, word in SENSOR_SHOWN.items()}


def test_every_state_with_every_input_is_as_the_plain_model_says() -> None:
    words = [sum(bits) for bits in itertools.product((0, ACKNOWLEDGE), (0, PARK), (0, ABSOLUTE), (0, PRESET))]
    inputs = list(itertools.product(words, (None, SensorError.SYNCHRONISATION), ("", "done", "failed")))
    start = SensorInterface(RANGE)
    start.preset_value = 500
    start.step(0, 500, 0)
    known = {(SensorState.NORMAL, 0): start}
    waiting = [(start, 0)]
    checked = 0
    while waiting:
        before, previous = waiting.pop()
        for word, error, answer in inputs:
            sensor = copy.deepcopy(before)
            if answer == "done":
                sensor.preset_done()
            elif answer == "failed":
                sensor.preset_failed()
            status, _, xist2 = sensor.step(word, 500, checked * PARKED_NS, error=error)
            name = sensor_state(before.state.name, previous, word, error is not None, answer)
            assert sensor.state is SensorState[name], (before.state, previous, word, error, answer)
            absolute = word & ABSOLUTE if name in ("NORMAL", "PRESETTING", "PRESET_DONE") else 0
            assert status == STATUS[sensor.state] | absolute
            assert (sensor.preset_request is not None) == (name == "PRESETTING")
            assert (xist2 == 500) == bool(absolute)
            assert (xist2 in set(SensorError)) == (name in ("ERROR", "ACKNOWLEDGING"))
            checked += 1
            if (sensor.state, word) not in known:
                known[sensor.state, word] = sensor
                waiting.append((sensor, word))
    assert {state for state, _ in known} == set(SensorState)
    assert (len(known), checked) == (40, 40 * len(inputs))


def test_the_table_names_every_state_and_event() -> None:
    assert {state for state, _ in TRANSITIONS} == set(TRANSITIONS.values()) == set(SENSOR_STATUS) == set(SensorState)
    assert {event for _, event in TRANSITIONS} == set(SensorEvent)
    assert dict(SENSOR_STATUS) == STATUS


@pytest.mark.parametrize("error", list(SensorError))
def test_an_error_shows_its_code_until_it_is_gone_and_acknowledged(error: SensorError) -> None:
    sensor = SensorInterface(RANGE)
    assert sensor.step(ABSOLUTE, 7, 0) == (ABSOLUTE, 7, 7)
    assert sensor.step(ABSOLUTE, 7, 0, error=error) == (0x8000, 7, int(error))
    assert sensor.step(ABSOLUTE | ACKNOWLEDGE, 7, 0, error=error) == (0x8800, 7, int(error))
    assert sensor.step(ABSOLUTE, 7, 0, error=error) == (0x8000, 7, int(error)), "still there"
    assert sensor.step(ABSOLUTE, 7, 0) == (0x8000, 7, int(error)), "gone, not acknowledged"
    assert sensor.step(ABSOLUTE | ACKNOWLEDGE, 7, 0) == (0x8800, 7, int(error))
    assert sensor.step(ABSOLUTE, 7, 0) == (ABSOLUTE, 7, 7)


@pytest.mark.parametrize("command", [0x0011, 0x0091, 0x0020])
def test_reference_marks_and_measuring_are_not_supported(command: int) -> None:
    sensor = SensorInterface(RANGE)
    sensor.step(0, 7, 0)
    assert sensor.step(command, 7, 0) == (0x8000, 7, 0x0F01)


def test_requests_active_at_connect_are_not_edges() -> None:
    sensor = SensorInterface(RANGE)
    for word in (PRESET, None, PRESET):
        sensor.step(word, 7, 0)
        assert sensor.preset_request is None
    sensor.step(0, 7, 0)
    sensor.step(PRESET, 7, 0)
    assert sensor.preset_request is not None


def test_lost_position_is_an_error_and_a_missing_first_one_is_not() -> None:
    sensor = SensorInterface(RANGE)
    assert sensor.step(ABSOLUTE, 0, 0, valid=False) == (0, 0, 0)
    assert sensor.step(ABSOLUTE, 7, 0) == (ABSOLUTE, 7, 7)
    assert sensor.step(ABSOLUTE, 0, 0, valid=False) == (0x8000, 7, 0x0001)


@pytest.mark.parametrize("value", [-1, RANGE, 2**31 - 1])
def test_an_absolute_preset_outside_the_range_is_refused(value: int) -> None:
    sensor = SensorInterface(RANGE)
    sensor.preset_value = value
    sensor.step(0, 7, 0)
    assert sensor.step(PRESET, 7, 0) == (0x8000, 7, 0x0F01)
    assert sensor.preset_request is None


def test_a_preset_before_there_is_a_position_is_an_error() -> None:
    sensor = SensorInterface(RANGE)
    sensor.step(0, 0, 0, valid=False)
    assert sensor.step(PRESET, 0, 0, valid=False) == (0x8000, 0, 0x0001)
    assert sensor.preset_request is None


def test_a_sensor_without_preset_refuses_it() -> None:
    sensor = SensorInterface(RANGE, preset_supported=False)
    sensor.step(0, 7, 0)
    assert sensor.step(PRESET | RELATIVE, 7, 0) == (0x8000, 7, 0x0F01)


def test_failed_preset_shows_its_error() -> None:
    sensor = SensorInterface(RANGE)
    sensor.step(0, 7, 0)
    sensor.step(PRESET, 7, 0)
    sensor.preset_failed(SensorError.COMMAND_NOT_SUPPORTED)
    assert sensor.step(PRESET, 7, 0) == (0x8000, 7, 0x0F01)


def test_unexpected_answer_changes_nothing() -> None:
    sensor = SensorInterface(RANGE)
    sensor.step(0, 7, 0)
    sensor.preset_failed()
    assert sensor.step(0, 7, 0) == (0, 7, 0)


@pytest.mark.parametrize("total_range", [0, -5, (1 << 64) + 1])
def test_impossible_range_is_rejected(total_range: int) -> None:
    with pytest.raises(ProfidriveError, match="total measuring range"):
        SensorInterface(total_range)


# -- the position -----------------------------------------------------------------------------------------------------


@given(
    total_range=st.sampled_from([1, 2, 3, 999, 1000, 1 << 16, (1 << 32) - 1, 1 << 32, 1 << 40]),
    start=st.integers(0, 1 << 40),
    moves=st.lists(st.floats(-0.999, 0.999), max_size=40),
)
def test_xist1_counts_across_every_wrap(total_range: int, start: int, moves: list[float]) -> None:
    sensor = SensorInterface(total_range)
    turned = start % total_range
    assert sensor.step(0, turned, 0)[1] == turned % (1 << 32)
    for share in moves:
        turned += int(share * ((total_range - 1) // 2))
        _, xist1, _ = sensor.step(0, turned % total_range, 0)
        assert xist1 == turned % (1 << 32)
        assert sensor.xist3 == turned % (1 << 64)


def signed_part(jump: int) -> int:
    """The jump the short way round the range."""
    return (jump + RANGE // 2) % RANGE - RANGE // 2


def signed(value: int, bits: int) -> int:
    return (value + (1 << (bits - 1))) % (1 << bits) - (1 << (bits - 1))


@given(
    value=st.integers(0, RANGE - 1),
    relative=st.booleans(),
    delay=st.integers(0, 5),
    late=st.booleans(),
    speed=st.integers(-20, 20),
    start=st.integers(0, RANGE - 1),
)
def test_a_preset_sets_the_position_and_leaves_xist1(
    value: int, relative: bool, delay: int, late: bool, speed: int, start: int
) -> None:
    """The device takes the preset ``delay`` cycles later, before or after its answer is seen; the shaft keeps turning."""
    sensor = SensorInterface(RANGE)
    sensor.preset_value = value
    turned, offset, now = start, 0, 0

    def cycle(word: int) -> tuple[int, int, int]:
        nonlocal turned, now
        turned += speed
        now += MS
        return sensor.step(word, (turned + offset) % RANGE, now)

    _, first_xist1, _ = cycle(ABSOLUTE)
    first = turned
    cycle(ABSOLUTE)  # from here on the motion is known
    word = ABSOLUTE | PRESET | (RELATIVE if relative else 0)
    cycle(word)
    request = sensor.preset_request
    assert request == PresetRequest(value, relative, ((turned if relative else 0) + value) % RANGE)
    for _ in range(delay):
        cycle(word)
    if late:
        sensor.preset_done()
        cycle(word)
    preset_at, jump = turned, request.position - turned
    offset = jump
    status, xist1, xist2 = cycle(word)
    if not late:
        sensor.preset_done()
    for _ in range(PRESET_EFFECT_NS // MS + 1):
        if status & PRESET:
            break
        status, xist1, xist2 = cycle(word)
    assert status == ABSOLUTE | PRESET
    assert xist2 == (request.position + turned - preset_at) % RANGE
    if abs(signed_part(jump)) > 4 * abs(speed):  # a smaller jump cannot be distinguished from motion
        assert abs(signed(xist1 - first_xist1, 32) - (turned - first)) <= abs(speed)
        assert signed(sensor.xist3, 64) % RANGE == xist2
    assert cycle(ABSOLUTE)[0] == ABSOLUTE


@pytest.mark.parametrize("relative", [0, RELATIVE])
def test_preset_is_confirmed_together_with_its_position(relative: int) -> None:
    sensor = SensorInterface(RANGE)
    sensor.preset_value = 400
    word = ABSOLUTE | PRESET | relative
    sensor.step(ABSOLUTE, 10, 0)
    sensor.step(word, 10, MS)
    sensor.preset_done()
    new = 410 if relative else 400
    assert sensor.step(word, 10, 2 * MS)[0::2] == (ABSOLUTE, 10)
    sensor.step(word, new, 3 * MS)
    assert sensor.step(word, new, 4 * MS) == (ABSOLUTE | PRESET, 10, new)


def test_confirmed_preset_without_effect_is_an_error() -> None:
    sensor = SensorInterface(RANGE)
    sensor.preset_value = 400
    sensor.step(0, 10, 0)
    sensor.step(PRESET, 10, MS)
    request = sensor.preset_request
    sensor.preset_done()
    assert sensor.step(PRESET, 10, 2 * MS) == (0, 10, 0)
    assert sensor.step(PRESET, 10, PRESET_EFFECT_NS) == (0, 10, 0)
    assert sensor.ineffective is None
    assert sensor.step(PRESET, 10, PRESET_EFFECT_NS + 2 * MS) == (ERROR, 10, SensorError.MEMORY)
    assert sensor.ineffective is request


def test_late_jump_of_a_preset_leaves_xist1() -> None:
    """Confirmed by SDO, carried out 300 ms later."""
    sensor = SensorInterface(RANGE)
    sensor.preset_value = 400
    sensor.step(0, 10, 0)
    sensor.step(PRESET, 10, MS)
    sensor.preset_done()
    assert sensor.step(PRESET, 10, 300 * MS) == (0, 10, 0)
    sensor.step(PRESET, 400, 301 * MS)
    assert sensor.step(PRESET | ABSOLUTE, 400, 302 * MS) == (PRESET | ABSOLUTE, 10, 400)


@pytest.mark.parametrize("preset", [10, 12])
def test_preset_to_the_present_position_is_confirmed_at_once(preset: int) -> None:
    """The position wobbles by one step."""
    sensor = SensorInterface(RANGE)
    sensor.preset_value = preset
    for now, position in enumerate((10, 11, 10)):
        sensor.step(0, position, now)
    sensor.step(PRESET, 11, 3)
    sensor.step(PRESET, 10, 4)
    sensor.preset_done()
    assert sensor.step(PRESET, preset, 5)[0] == PRESET


@pytest.mark.parametrize(
    ("preset", "speed", "update_ms"),
    [
        *((0, 1, 1), (0, 7, 20), (0, -13, 50)),
        *((300, 1, 20), (300, 7, 50), (300, -13, 1)),
        *((700, 1, 50), (700, 7, 1), (700, -13, 20)),
    ],
)
def test_preset_without_effect_is_an_error_also_of_a_turning_shaft(preset: int, speed: int, update_ms: int) -> None:
    """The shaft passes the preset value meanwhile, and its position is sent every ``update_ms`` with some noise."""
    sensor = SensorInterface(RANGE)
    sensor.preset_value = preset
    start = 100 * update_ms

    def at(now: int) -> int:
        sent = now - now % update_ms
        noise = random.Random(sent).choice((0, 0, 1)) if speed > 1 else 0
        return (500 + sent * speed // update_ms + noise) % RANGE

    for now in range(start):
        sensor.step(0, at(now), now * MS)
    while abs((at(start) - preset + RANGE // 2) % RANGE - RANGE // 2) < 100:
        sensor.step(0, at(start), start * MS)
        start += 1
    sensor.step(PRESET, at(start), start * MS)
    sensor.preset_done()
    statuses = [
        sensor.step(PRESET, at(now), now * MS)[0] for now in range(start + 1, start + PRESET_EFFECT_NS // MS + 10)
    ]
    assert set(statuses) == {0, ERROR}


def test_a_jump_long_after_a_preset_is_motion() -> None:
    sensor = SensorInterface(RANGE)
    sensor.preset_value = 400
    sensor.step(0, 10, 0)
    sensor.step(PRESET, 10, 0)
    sensor.preset_done()
    assert sensor.step(0, 10, 0)[1] == 10
    assert sensor.step(0, 400, PRESET_EFFECT_NS + 1)[1] == 400


@pytest.mark.parametrize(("word", "error"), [(PARK, None), (PRESET, SensorError.SENSOR_GROUP)])
def test_a_jump_long_after_an_unanswered_preset_is_motion(word: int, error: SensorError | None) -> None:
    sensor = SensorInterface(RANGE)
    sensor.preset_value = 400
    sensor.step(0, 10, 0)
    sensor.step(PRESET, 10, 0)
    sensor.step(word, 10, MS, error=error)
    assert sensor.preset_request is None
    sensor.step(word, 10, 2 * MS)
    sensor.step(0, 10, 2 * MS + PARKED_NS)
    assert sensor.step(0, 400, 2 * MS + PRESET_EFFECT_NS + 1)[1] == 400


def test_parking_freezes_xist1_and_skips_the_motion_meanwhile() -> None:
    sensor = SensorInterface(RANGE)
    sensor.step(0, 100, 0)
    assert sensor.step(0, 110, 0) == (0, 110, 0)
    assert sensor.step(PARK | ABSOLUTE, 300, 0) == (PARK, 110, 0)
    assert sensor.step(PARK, 0, 0, valid=False) == (PARK, 110, 0)
    assert sensor.step(0, 500, PARKED_NS) == (0, 110, 0)
    assert sensor.step(ABSOLUTE, 505, PARKED_NS) == (ABSOLUTE, 115, 505)
    assert sensor.xist3 == 505


def test_xist1_continues_with_another_range() -> None:
    sensor = SensorInterface(RANGE)
    sensor.step(0, 990, 0)
    sensor.set_total_range(4000)
    assert sensor.step(0, 3900, 0)[1] == 990
    assert sensor.step(0, 3950, 0)[1] == 1040


def test_xist1_is_32_bit_and_xist3_64() -> None:
    sensor = SensorInterface(1 << 40)
    _, xist1, _ = sensor.step(0, (1 << 32) + 5, 0)
    assert (xist1, sensor.xist3) == (5, (1 << 32) + 5)
    small = SensorInterface(RANGE)
    small.step(0, 1, 0)
    _, xist1, _ = small.step(0, RANGE - 1, 0)
    assert (xist1, small.xist3) == ((1 << 32) - 1, (1 << 64) - 1)


# -- STW2_ENC and ZSW2_ENC --------------------------------------------------------------------------------------------

CONTROL, FAULT_ACKNOWLEDGE = 0x0400, 0x0080
REQUESTED, WARNING, FAULT = 0x0200, 0x0080, 0x0008


def control() -> EncoderControl:
    return EncoderControl(SignOfLife(MONITORING_OFF))


def test_a_fault_stays_until_it_is_gone_and_acknowledged_by_an_edge() -> None:
    encoder = control()
    assert encoder.step(CONTROL | FAULT_ACKNOWLEDGE, fault=True, warning=False) == REQUESTED | FAULT
    assert encoder.step(CONTROL | FAULT_ACKNOWLEDGE, fault=False, warning=False) == REQUESTED | FAULT, "no edge"
    assert encoder.step(CONTROL, fault=False, warning=True) == REQUESTED | FAULT | WARNING
    assert encoder.step(CONTROL | FAULT_ACKNOWLEDGE, fault=True, warning=False) == REQUESTED | FAULT, "still there"
    assert encoder.step(CONTROL, fault=False, warning=False) == REQUESTED | FAULT
    assert encoder.step(CONTROL | FAULT_ACKNOWLEDGE, fault=False, warning=False) == REQUESTED
    assert encoder.acknowledged


def test_without_control_by_plc_only_the_sign_of_life_is_evaluated() -> None:
    encoder = control()
    encoder.step(0, fault=True, warning=False)
    assert encoder.step(FAULT_ACKNOWLEDGE | 0x3000, fault=False, warning=False) == REQUESTED | FAULT | 0x1000
    assert not encoder.has_control
    assert encoder.step(FAULT_ACKNOWLEDGE | CONTROL | 0x4000, fault=False, warning=False) == REQUESTED | FAULT | 0x2000


def test_acknowledge_set_at_connect_is_not_an_edge() -> None:
    encoder = control()
    encoder.step(CONTROL, fault=True, warning=False)
    encoder.step(None, fault=False, warning=False)
    assert encoder.step(CONTROL | FAULT_ACKNOWLEDGE, fault=False, warning=False) & FAULT


# -- speed ------------------------------------------------------------------------------------------------------------


def test_published_normalisation_300_of_3000_rpm() -> None:
    reference = rotary_speed_reference(3000, 4096)
    assert reference == 204800
    assert speed_normalisation(DataType.N2, reference).to_wire(20480) == 0x0666
    assert speed_normalisation(DataType.N4, reference).to_wire(102400) == 0x2000_0000
    assert speed_normalisation(DataType.N4, Fraction(1, 1000)).to_wire(-(2**31)) == -(2**31)


def test_a_speed_is_n2_or_n4() -> None:
    with pytest.raises(ProfidriveError, match="N2 or N4"):
        speed_normalisation(DataType.UNSIGNED16, 5)
    with pytest.raises(ProfidriveError, match="above 0"):
        speed_normalisation(DataType.N2, 0)
