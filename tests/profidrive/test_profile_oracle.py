"""The gateway against the oracle of published tables, over random words and times."""

from __future__ import annotations

import copy
import itertools

from hypothesis import given
from hypothesis import strategies as st

from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.encoder import PARKED_NS, SensorInterface
from pdgw.profidrive.parameters.catalogue import ParameterSpec, Scope
from pdgw.profidrive.parameters.error_numbers import ParameterErrorNumber, ParameterRefused
from pdgw.profidrive.parameters.model import BoundParameter, Parameter, answer
from pdgw.profidrive.sensor_states import SensorError
from tests.gateway.axis.test_velocity import Bench
from tests.support.documents import profile_oracle as oracle

CONTROL, RUN = 0x0400, 0x0070
SETTLING = 60
"""Cycles of 4 ms in which the plain drive has done whatever a word asks."""

_words = st.builds(lambda low, ack: CONTROL | RUN | low | ack, st.integers(0, 15), st.sampled_from((0, 0, 0, 0x80)))
_steps = st.lists(
    st.one_of(
        st.tuples(_words, st.integers(SETTLING, 2 * SETTLING)),
        st.just((0x047E, SETTLING)),
        st.just((0x047F, SETTLING)),
        st.sampled_from(("fault", "repaired")),
    ),
    max_size=14,
)


@given(steps=_steps, number=st.sampled_from([1, 2, 3, 102]))
def test_zsw1_is_that_of_the_general_state_machine(steps: list[str | tuple[int, int]], number: int) -> None:
    bench, machine = Bench(number), oracle.StateMachine()
    bench.step(CONTROL, cycles=SETTLING)
    machine.run_out(CONTROL)
    broken = False
    for step in steps:
        if step == "fault":
            machine.fault()
            bench.drive.fault()
            broken = True
        elif step == "repaired":
            machine.repaired()
            broken = False
        elif isinstance(step, tuple):
            word, cycles = step
            if broken:
                word &= ~0x80  # the plain drive has no causes: no acknowledgement while there is one
            shown = bench.step(word, 0x1000 if number == 1 else 0x1000_0000, cycles)
            expected = machine.run_out(word)
            assert shown & oracle.STATE_BITS == expected, (f"{word:04X}h", machine.state)


@given(
    cycles=st.lists(
        st.tuples(
            st.sets(st.sampled_from((0x8000, 0x4000, 0x1000))),
            st.sampled_from((None, None, None, SensorError.SYNCHRONISATION)),
            st.sampled_from(("", "", "done", "failed")),
            st.integers(1, 3),
        ),
        max_size=30,
    )
)
def test_g1_zsw_is_that_of_the_sensor_machine(
    cycles: list[tuple[set[int], SensorError | None, str, int]],
) -> None:
    sensor = SensorInterface(1000)
    sensor.preset_value = 500
    sensor.step(0, 500, 0)
    state, before, now = "NORMAL", 0, 0
    for bits, error, done, times in cycles:
        word = sum(bits)
        if done == "done":
            sensor.preset_done()
        elif done == "failed":
            sensor.preset_failed()
        answered = done
        for _ in range(times):
            now += PARKED_NS
            status, _, _ = sensor.step(word, 500, now, error=error)
            state = oracle.sensor_state(state, before, word, error is not None, answered)
            before, answered = word, ""
            assert status == oracle.SENSOR_SHOWN[state]


PNUS = {
    922: oracle.OraclePnu(0x06, [9], limits=(1, 100)),
    925: oracle.OraclePnu(0x03, [-3], limits=(-5, 5)),
    944: oracle.OraclePnu(0x06, [7]),
    978: oracle.OraclePnu(0x05, [1, 2, 3], array=True),
    948: oracle.OraclePnu(0x07, [10, 11, 12, 13], array=True),
}


class Device:
    """The same parameters in the gateway's model."""

    def __init__(self, table: dict[int, oracle.OraclePnu]) -> None:
        self.table = table

    def parameter(self, pnu: int) -> Parameter:
        found = self.table.get(pnu)
        if found is None:
            raise ParameterRefused(ParameterErrorNumber.IMPERMISSIBLE_PNU)
        low, high = found.limits or (None, None)
        spec = ParameterSpec(
            pnu, "", "", DataType.from_code(found.code), Scope.DRIVE_OBJECT, array=found.array, low=low, high=high
        )

        def keep(value: int) -> None:
            found.values[0] = value

        get = (lambda: found.values) if found.array else (lambda: found.values[0])
        return BoundParameter(spec, get, keep if found.limits else None)

    def check_writable(self, pnu: int) -> None:
        """Always."""


_addresses = st.tuples(
    st.sampled_from((0x10, 0x10, 0x10, 0x40)),
    st.sampled_from((0, 1, 1, 2, 3, 235)),
    st.sampled_from((*PNUS, *PNUS, 0, 5000)),
    st.sampled_from((0, 0, 0, 1, 2, 5, 0xFFFF)),
)
_areas = st.tuples(st.sampled_from((0x03, 0x05, 0x06, 0x07, 0x42, 0x43)), st.integers(0, 3), st.integers(-8, 120))


def _request(
    reference: int, service: int, parts: list[tuple[tuple[int, int, int, int], tuple[int, int, int]]]
) -> bytes:
    data = bytes((reference, service, 1, len(parts)))
    for (attribute, elements, pnu, subindex), _ in parts:
        used = 0x10 if service == 2 else attribute
        data += bytes((used, elements)) + pnu.to_bytes(2, "big") + subindex.to_bytes(2, "big")
    for _, (code, count, value) in parts if service == 2 else ():
        size = DataType.from_code(code).size
        area = (value & ((1 << 8 * size) - 1)).to_bytes(size, "big") * count
        data += bytes((code, count)) + area + b"\0" * (len(area) % 2)
    return data


@given(
    requests=st.lists(
        st.builds(
            _request,
            st.integers(1, 255),
            st.sampled_from((1, 1, 1, 2, 2, 2, 3, 0)),
            st.lists(st.tuples(_addresses, _areas), min_size=1, max_size=4),
        ),
        max_size=6,
    )
)
def test_answers_are_those_of_the_parameter_manager(requests: list[bytes]) -> None:
    manager, device = oracle.ParameterManager(copy.deepcopy(PNUS)), Device(copy.deepcopy(PNUS))
    for request in requests:
        assert answer(request, lambda _: device, 4096) == manager.answer(request), request.hex(" ")


def test_the_oracle_reaches_every_state() -> None:
    machine = oracle.StateMachine()
    seen = {machine.run_out(word) & 0x4F for word in (0, 0x06, 0x07, 0x0F)}
    machine.fault()
    assert seen | {machine.run_out(0x0F) & 0x4F} == set(oracle.SHOWN.values())
    words = [sum(bits) for bits in itertools.product((0, 0x8000), (0, 0x4000), (0, 0x1000))]
    assert {
        oracle.sensor_state(state, 0, word, False, "done") for state in oracle.SENSOR_SHOWN for word in words
    } == set(oracle.SENSOR_SHOWN)
