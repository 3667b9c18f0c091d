"""The positioner's configuration as parameters P2571 to P2623: what each is, and what stored values make of the configuration.

Numbers and the codes of P2621 and P2623 are those of one manufacturer's basic positioner (unverified). Values are those of the
configuration keys: LU, 1000 LU/min, 1000 LU/s2, percent. An element of P2616 to P2623 is a block by its number. Pure.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from pydantic import ValidationError

from pdgw.explain import problems
from pdgw.gateway.configuration.tables.positioner import BlockConfig, PositionerConfig
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.motion.blocks import HIGHEST_BLOCK, PERCENT_MAX, Block, BlockMode, BlockNext, BlockTask
from pdgw.gateway.motion.requests import PositionerChoices
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.parameters.catalogue import ParameterSpec, Scope

LOWEST, HIGHEST = DataType.INTEGER32.integer_range
BLOCK_COUNT: Final = HIGHEST_BLOCK + 1
INACTIVE: Final = -1
"""P2616 of a block that is not there."""
_I16, _I32, _U16, _U32 = DataType.INTEGER16, DataType.INTEGER32, DataType.UNSIGNED16, DataType.UNSIGNED32


@dataclass(frozen=True, slots=True)
class Item:
    """A parameter and its key in the configuration."""

    spec: ParameterSpec
    key: str


def _item(
    pnu: int, key: str, name: str, type_: DataType, unit: str, low: int, high: int, *, array: bool = False
) -> Item:
    meaning = f"[[axis.block]] {key}" if array else f"[axis.positioner] {key}"
    spec = ParameterSpec(pnu, name, meaning, type_, Scope.AXIS, array, True, low, high, unit)
    return Item(spec, key)


LIMIT_KEYS: Final = ("software_limits[0]", "software_limits[1]")
ITEMS: Final = MappingProxyType(
    {
        item.spec.pnu: item
        for item in (
            _item(2571, "max_velocity", "max velocity", _U32, "1000 LU/min", 1, HIGHEST),
            _item(2572, "max_acceleration", "max accel", _U32, "1000 LU/s2", 1, HIGHEST),
            _item(2573, "max_deceleration", "max decel", _U32, "1000 LU/s2", 1, HIGHEST),
            _item(2576, "modulo_range", "modulo range", _U32, "LU", 0, HIGHEST),
            _item(2577, "modulo_correction", "modulo active", _U16, "", 0, 1),
            _item(2580, LIMIT_KEYS[0], "sw limit minus", _I32, "LU", LOWEST, HIGHEST),
            _item(2581, LIMIT_KEYS[1], "sw limit plus", _I32, "LU", LOWEST, HIGHEST),
            _item(2585, "jog_1_velocity", "jog 1 velocity", _I32, "1000 LU/min", LOWEST, HIGHEST),
            _item(2586, "jog_2_velocity", "jog 2 velocity", _I32, "1000 LU/min", LOWEST, HIGHEST),
            _item(2587, "jog_1_distance", "jog 1 distance", _U32, "LU", 0, HIGHEST),
            _item(2588, "jog_2_distance", "jog 2 distance", _U32, "LU", 0, HIGHEST),
            _item(2599, "reference_coordinate", "ref coordinate", _I32, "LU", LOWEST, HIGHEST),
        )
    }
)
"""Parameters by PNU. If one of two limits is not configured, it is the end of the range."""
BLOCK_ITEMS: Final = MappingProxyType(
    {
        item.spec.pnu: item
        for item in (
            _item(2616, "number", "block number", _I16, "", INACTIVE, HIGHEST_BLOCK, array=True),
            _item(2617, "position", "block position", _I32, "LU", LOWEST, HIGHEST, array=True),
            _item(2618, "velocity", "block velocity", _U32, "1000 LU/min", 0, HIGHEST, array=True),
            _item(2619, "acceleration", "block accel", _U16, "%", 1, PERCENT_MAX, array=True),
            _item(2620, "deceleration", "block decel", _U16, "%", 1, PERCENT_MAX, array=True),
            _item(2621, "task", "block task", _U16, "", 1, 8, array=True),
            _item(2622, "value", "block value", _I32, "", 0, HIGHEST, array=True),
            _item(2623, "next and mode", "block mode", _U16, "", 0, 0xFFF, array=True),
        )
    }
)
"""In the order of a row."""
_TASKS: Final = {
    1: (BlockTask.POSITION, None),
    2: (BlockTask.FIXED_STOP, None),
    3: (BlockTask.POSITION, BlockMode.ENDLESS_POSITIVE),
    4: (BlockTask.POSITION, BlockMode.ENDLESS_NEGATIVE),
    5: (BlockTask.WAIT, None),
    6: (BlockTask.GOTO, None),
    7: (BlockTask.SET_OUTPUT, None),
    8: (BlockTask.RESET_OUTPUT, None),
}
"""P2621; endless motion is a task of its own there."""
_NEXT: Final = (BlockNext.END, BlockNext.CONTINUE_WITH_STOP, BlockNext.FLYING, BlockNext.EXTERNAL)
_MODES: Final = (BlockMode.ABSOLUTE, BlockMode.RELATIVE)
_NEXT_SHIFT, _MODE_SHIFT = 4, 8
"""P2623: bits 4-7 ``next``, bits 8-11 absolute or relative position."""
_EMPTY_ROW: Final = (INACTIVE, 0, 600, PERCENT_MAX, PERCENT_MAX, 1, 0, 0)

Row = tuple[int, ...]


def row_of(block: Block) -> Row:
    """The values of P2616 to P2623 of a block."""
    mode = block.mode if block.mode.direction else None
    task = next(code for code, item in _TASKS.items() if item == (block.task, mode))
    position_mode = 0 if mode is not None else _MODES.index(block.mode)
    how = _NEXT.index(block.next) << _NEXT_SHIFT | position_mode << _MODE_SHIFT
    numbers = (block.number, block.position, block.velocity, block.acceleration, block.deceleration)
    return (*numbers, task, block.value, how)


def _block_of(number: int, row: Row) -> BlockConfig:
    position, velocity, acceleration, deceleration, code, value, how = row[1:]
    task, mode = _TASKS[code]
    place, meant = how >> _NEXT_SHIFT & 0xF, how >> _MODE_SHIFT & 0xF
    if place >= len(_NEXT) or (mode is None and meant >= len(_MODES)):
        raise GatewayError(
            f"block {number}: P2623 = {how:04X}h is not allowed, expected 00m0h with next 0-3 and mode 0-1"
        )
    try:
        return BlockConfig(
            number=number,
            position=position,
            velocity=velocity,
            acceleration=acceleration,
            deceleration=deceleration,
            mode=mode or _MODES[meant],
            task=task,
            next=_NEXT[place],
            value=value,
        )
    except ValidationError as error:
        raise GatewayError(f"block {number}: {problems(error, BlockConfig)[0].line}") from error


def _typed(configured: object, value: int) -> int:
    """A stored value in the type of its key."""
    return bool(value) if isinstance(configured, bool) else value


class PositionerValues:
    """The configuration with stored values in place of its own; ``choices`` are the settings for the axis.

    ``stored``: values by PNU; ``rows``: those of the blocks by number.
    """

    def __init__(
        self,
        config: PositionerConfig,
        blocks: Sequence[BlockConfig],
        stored: Mapping[int, int],
        rows: Mapping[int, Sequence[int]],
    ) -> None:
        self._config = config
        self._stored = {pnu: value for pnu, value in stored.items() if pnu in ITEMS}
        self._rows: dict[int, Row] = {item.number: row_of(item.block()) for item in blocks}
        self._rows |= {number: tuple(row) for number, row in rows.items() if len(row) == len(BLOCK_ITEMS)}

    def value(self, pnu: int) -> int:
        """The value of a parameter of ``ITEMS``."""
        if pnu in self._stored:
            return self._stored[pnu]
        key = ITEMS[pnu].key
        if key in LIMIT_KEYS:
            return (self._config.software_limits or (LOWEST, HIGHEST))[LIMIT_KEYS.index(key)]
        return int(getattr(self._config, key))

    def row(self, number: int) -> Row:
        """The row of a block, also of a missing one."""
        return self._rows.get(number, _EMPTY_ROW)

    def choices(self) -> PositionerChoices:
        """GatewayError for values that do not fit together."""
        document = self._config.model_dump()
        document |= {
            ITEMS[pnu].key: _typed(document[ITEMS[pnu].key], value)
            for pnu, value in self._stored.items()
            if ITEMS[pnu].key not in LIMIT_KEYS
        }
        limits = tuple(self.value(pnu) for pnu, item in ITEMS.items() if item.key in LIMIT_KEYS)
        document["software_limits"] = None if limits == (LOWEST, HIGHEST) else limits
        try:
            config = PositionerConfig.model_validate(document)
        except ValidationError as error:
            raise GatewayError(problems(error, PositionerConfig)[0].line) from error
        active = sorted((number, row) for number, row in self._rows.items() if row[0] != INACTIVE)
        return config.choices(tuple(_block_of(number, row) for number, row in active))
