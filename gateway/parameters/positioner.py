"""The positioner's parameters on the parameter channel: read any time, written at standstill, kept in the store.

A change that does not fit together with the rest is refused and nothing changes. Source: docs/motion.md "Parameters".
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from pdgw.gateway.configuration.positioner_values import (
    BLOCK_COUNT,
    BLOCK_ITEMS,
    INACTIVE,
    ITEMS,
    Item,
    PositionerValues,
    Row,
)
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.motion.requests import PositionerChoices
from pdgw.gateway.store import DoParameters
from pdgw.profidrive.parameters.codec import Values
from pdgw.profidrive.parameters.description import Description
from pdgw.profidrive.parameters.errors import ParameterErrorNumber as Number
from pdgw.profidrive.parameters.errors import ParameterRefused
from pdgw.profidrive.parameters.model import BoundParameter, Parameter, converted

_PLACES = {pnu: place for place, pnu in enumerate(BLOCK_ITEMS)}


class PositionerParameters:
    """Parameters of one axis. ``values`` reads the stored ones; ``save`` stores changes of a function; ``take`` sets the choices
    of the axis."""

    def __init__(
        self,
        stored: Callable[[], DoParameters],
        values: Callable[[DoParameters], PositionerValues],
        save: Callable[[Callable[[DoParameters], None]], None],
        take: Callable[[PositionerChoices], None],
        require_power_off: Callable[[], None],
    ) -> None:
        self._stored = stored
        self._values = values
        self._save = save
        self._take = take
        self._require_power_off = require_power_off

    def parameter(self, pnu: int) -> Parameter | None:
        """None where it is none of the positioner's."""
        if pnu in ITEMS:
            return BoundParameter(
                ITEMS[pnu].spec, lambda: self.now.value(pnu), lambda value: self._change(lambda s: _put(s, pnu, value))
            )
        return _BlockParameter(self, BLOCK_ITEMS[pnu]) if pnu in BLOCK_ITEMS else None

    @property
    def now(self) -> PositionerValues:
        """As they are in force."""
        return self._values(self._stored())

    def put_blocks(self, pnu: int, first: int, numbers: Sequence[int]) -> None:
        """Elements of P2616 to P2623."""
        place, now = _PLACES[pnu], self.now
        rows: dict[int, Row] = {}
        for number, value in enumerate(numbers, first):
            row = now.row(number)
            if not place and value not in {INACTIVE, number}:
                raise ParameterRefused(Number.VALUE_IMPERMISSIBLE, number)
            rows[number] = (*row[:place], value, *row[place + 1 :])
        self._change(lambda stored: stored.positioner_blocks.update(rows))

    def _change(self, change: Callable[[DoParameters], None]) -> None:
        self._require_power_off()
        before = self._stored()
        changed = before.model_copy(deep=True)
        change(changed)
        try:
            choices = self._values(changed).choices()
        except GatewayError as error:
            raise ParameterRefused(Number.VALUE_IMPERMISSIBLE) from error
        self._save(change)
        try:
            self._require_power_off()  # storing took time
        except ParameterRefused:
            self._save(lambda stored: _put_back(stored, before))
            raise
        self._take(choices)


def _put(stored: DoParameters, pnu: int, value: int) -> None:
    stored.positioner[pnu] = value


def _put_back(stored: DoParameters, before: DoParameters) -> None:
    stored.positioner, stored.positioner_blocks = before.positioner, before.positioner_blocks


class _BlockParameter:
    """One of P2616 to P2623: an array with an element for each block."""

    texts: Sequence[str] = ()

    def __init__(self, owner: PositionerParameters, item: Item) -> None:
        self._owner = owner
        self._spec = item.spec

    def _check(self, subindex: int, elements: int) -> None:
        if elements == 0:
            raise ParameterRefused(Number.ADDRESS_IMPERMISSIBLE)
        if subindex + elements > BLOCK_COUNT:
            raise ParameterRefused(Number.FAULTY_SUBINDEX, max(subindex, BLOCK_COUNT) if elements > 1 else None)

    def read(self, subindex: int, elements: int) -> Values:
        self._check(subindex, elements)
        now, place = self._owner.now, _PLACES[self._spec.pnu]
        return Values(self._spec.type, tuple(now.row(number)[place] for number in range(subindex, subindex + elements)))

    def write(self, subindex: int, elements: int, values: Values) -> None:
        self._check(subindex, elements)
        spec = self._spec
        numbers = [int(value) for value in converted(values, spec.type).values]
        low, high = spec.low, spec.high
        for place, number in enumerate(numbers, subindex):
            if (low is not None and number < low) or (high is not None and number > high):
                raise ParameterRefused(Number.LIMIT_EXCEEDED, place)
        self._owner.put_blocks(spec.pnu, subindex, numbers)

    def description(self) -> Description:
        spec = self._spec
        return Description(spec.type, spec.name, True, BLOCK_COUNT, True, False, spec.low or 0, spec.high or 0)
