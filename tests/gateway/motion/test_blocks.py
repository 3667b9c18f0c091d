"""Traversing blocks: what a table may hold."""

from __future__ import annotations

import pytest

from pdgw.gateway.errors import GatewayError
from pdgw.gateway.motion.blocks import Block, BlockMode, BlockNext, BlockTable, BlockTask

GO_ON = BlockNext.CONTINUE_WITH_STOP


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"number": 128, "velocity": 1}, r"block 128: number = 128 is not allowed, expected 0\.\.127"),
        ({"number": 1}, r"block 1: velocity = 0 is not allowed, expected 1"),
        ({"number": 1, "velocity": 1, "acceleration": 101}, "acceleration = 101"),
        ({"number": 1, "velocity": 1, "position": 1 << 31}, "position = 2147483648"),
        ({"number": 1, "velocity": 1, "value": 3}, "value = 3 is not allowed, expected 0$"),
        ({"number": 1, "task": BlockTask.WAIT, "value": -1}, "value = -1"),
        ({"number": 1, "task": BlockTask.SET_OUTPUT, "value": 4}, r"value = 4 is not allowed, expected 1\.\.3"),
        ({"number": 1, "task": BlockTask.WAIT, "next": BlockNext.FLYING}, "next = flying"),
        ({"number": 1, "velocity": 1, "mode": BlockMode.ENDLESS_POSITIVE, "next": GO_ON}, "next = continue-with-stop"),
        (
            {"number": 1, "velocity": 1, "task": BlockTask.FIXED_STOP, "value": 9, "next": BlockNext.FLYING},
            "fixed-stop",
        ),
    ],
)
def test_a_block_is_refused_with_number_key_value_and_what_is_allowed(values: dict[str, object], message: str) -> None:
    with pytest.raises(GatewayError, match=message):
        Block(**values)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("blocks", "message"),
    [
        ([Block(1, 0, 1), Block(1, 5, 1)], "block 1: defined twice"),
        ([Block(1, 0, 1, next=GO_ON)], "block 1: continues with block 2, which is missing"),
        ([Block(1, task=BlockTask.GOTO, value=7)], "block 1: continues with block 7, which is missing"),
        ([Block(1, task=BlockTask.GOTO, value=1)], "block 1: the chain is a loop"),
        (
            [Block(1, task=BlockTask.SET_OUTPUT, value=1, next=GO_ON), Block(2, task=BlockTask.GOTO, value=1)],
            "block 1: the chain is a loop",
        ),
        (
            [Block(1, task=BlockTask.WAIT, next=GO_ON), Block(2, task=BlockTask.GOTO, value=1)],
            "block 1: the chain is a loop",
        ),
    ],
)
def test_a_table_that_cannot_be_run_is_refused(blocks: list[Block], message: str) -> None:
    with pytest.raises(GatewayError, match=message):
        BlockTable(blocks)


def test_a_ring_that_moves_or_waits_is_allowed() -> None:
    assert len(BlockTable([Block(1, 0, 1, next=GO_ON), Block(2, task=BlockTask.GOTO, value=1)])) == 2
    BlockTable([Block(1, task=BlockTask.WAIT, value=10, next=GO_ON), Block(2, task=BlockTask.GOTO, value=1)])
