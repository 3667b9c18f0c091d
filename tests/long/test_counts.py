"""What a cycle costs, in counts that are the same on a busy machine; `make long LONG=counts` counts the instructions, too.

After a change that is worth what it costs: ``python -m tests.long.counts.write``.
"""

from __future__ import annotations

import pytest

from pdgw.gateway.service.build import COMPILED, kind
from tests.long.counts import exchange
from tests.long.counts.axis_cycle import TELEGRAMS, bytecodes, kept_blocks, peak_bytes
from tests.long.counts.golden import PYTHON, exceeded, golden
from tests.long.counts.instructions import parse

GOLDEN = golden()
pure = pytest.mark.skipif(kind() == COMPILED, reason="compiled code has no bytecodes, and its calls are not seen")
same_python = pytest.mark.skipif(PYTHON not in GOLDEN["bytecodes"], reason=f"no golden counts for Python {PYTHON}")


@pure
@pytest.mark.parametrize("axes", exchange.AXES)
def test_system_calls_of_a_cycle(axes: int) -> None:
    wanted = GOLDEN["system_calls"][str(axes)]
    assert wanted["send"] == wanted["recv"] == axes, "one RPDO to and one TPDO from each drive"
    assert exceeded(f"system calls, {axes} axes", exchange.system_calls(axes), wanted) == ""


@pure
@same_python
@pytest.mark.parametrize("axes", exchange.AXES)
def test_bytecodes_of_a_cycle_of_the_whole_gateway(axes: int) -> None:
    wanted = GOLDEN["exchange"][PYTHON][str(axes)]
    assert exceeded(f"bytecodes of a cycle, {axes} axes", exchange.bytecodes(axes), wanted) == ""


@pure
@same_python
@pytest.mark.parametrize("number", TELEGRAMS)
def test_bytecodes_and_memory_of_an_axis_cycle(number: int) -> None:
    assert exceeded(f"bytecodes, telegram {number}", bytecodes(number), GOLDEN["bytecodes"][PYTHON][str(number)]) == ""
    peak = {"bytes": float(peak_bytes(number))}
    assert exceeded(f"memory, telegram {number}", peak, {"bytes": GOLDEN["peak_bytes"][PYTHON][str(number)]}) == ""


@pytest.mark.parametrize("number", [1, 9])
def test_an_axis_cycle_keeps_no_memory(number: int) -> None:
    """One block in a cycle would count as 1; a queue that begins another part of itself counts as less."""
    assert abs(kept_blocks(number)) < 0.5


def test_a_count_that_grew_by_more_than_a_twentieth_is_explained() -> None:
    wanted = {"a": 60.0, "b": 40.0}
    assert exceeded("x", wanted, wanted) == ""
    assert exceeded("x", {"a": 65.0, "b": 40.0}, wanted) == ""
    assert exceeded("x", {"a": 61.0, "c": 30.0, "b": 40.0}, wanted) == "\n".join(
        ["x: 131, allowed: 100 + 5%; what grew:", "  c: 0 -> 30", "  a: 60 -> 61"]
    )


def test_a_file_of_callgrind_is_read() -> None:
    """Costs of calls belong to the called function, whose name is written once."""
    text = "events: Ir\n\nfl=(1) a.c\nfn=(1) main\n3 10\ncfn=(2) work\ncalls=2 7\n4 500\n+1 5\n\nfn=(2)\n7 500\n* 1\n"
    assert parse(text) == {"main": 15, "work": 501}
