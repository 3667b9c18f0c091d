"""Selection of packets, and of their units and signals: by options, by expressions, by changes.

Filter expressions are ``stw1.on == 0 and axis == 1``: Python's syntax for comparisons, ``and``, ``or``, ``not``, ``in``,
arithmetic and bit operations on numbers; no other code is executed. Values are those of documents: percent for N2/N4, else
raw; text is compared without case. If the packet has a signal of the expression, other signals have their last known values of
the same axis, so words of different packets can be compared. Any other missing name makes the comparison unknown; unknown is
neither true nor false (``not`` keeps it), and only true results pass. ``--changes-only`` gives only what changed, over the
packets of each stream.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.frame import TRAILER
from pdgw.tools.decoder.frames.canopen.can_records import CanRecord, HeartbeatRecord, SyncRecord
from pdgw.tools.decoder.frames.records import CyclicRecord, ProcessData, ProcessDataLayout, Record
from pdgw.tools.decoder.view.names import RECORD_NAMES, Getter, Names, Value


@dataclass
class Selection:
    """All criteria together; a packet is shown when it meets each of them.

    Times are nanoseconds of the capture's clock, both ends included. ``signals`` are
    identifiers of signals, objects or fields of packets (``Names.split``), of which a packet has to have one.
    """

    begin_ns: int | None = None
    end_ns: int | None = None
    signals: Sequence[str] = ()
    filter: Filter | None = None
    changes: Changes | None = None

    @property
    def everything(self) -> bool:
        """Whether nothing is left out."""
        return not (self.begin_ns is not None or self.end_ns is not None or self.signals or self.filter or self.changes)

    def select(self, record: Record) -> tuple[ProcessData, ...] | None:
        """The units of a packet to show (empty for a packet without units); None to leave the packet out."""
        if self.begin_ns is not None and record.time_ns < self.begin_ns:
            return None
        if self.end_ns is not None and record.time_ns > self.end_ns:
            return None
        units: tuple[ProcessData, ...] | None = self.filter.select(record) if self.filter else record.units
        if units is not None and self.signals:
            units = self._with_signals(record, units)
        if units is not None and self.changes is not None:
            units = self.changes.select(record, units)
        return units

    def _with_signals(self, record: Record, units: tuple[ProcessData, ...]) -> tuple[ProcessData, ...] | None:
        reduced_units = tuple(part for unit in units if (part := self._of_signals(unit)) is not None)
        fields = (RECORD_NAMES[name] for name in self.signals if name in RECORD_NAMES)
        if reduced_units or any(getter(record, None) is not None for getter in fields):
            return reduced_units
        return None

    def _of_signals(self, unit: ProcessData) -> ProcessData | None:
        positions = [unit.layout.positions[name] for name in self.signals if name in unit.layout.positions]
        return reduced(unit, sorted(positions)) if positions else None


Evaluate = Callable[[Record, ProcessData | None], Any]

_MAX_LENGTH: Final = 2000
_MAX_SHIFT: Final = 64
_COMPARISONS: Final[dict[type[ast.cmpop], Callable[[Any, Any], bool]]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.In: lambda one, several: one in several,
    ast.NotIn: lambda one, several: one not in several,
}
_ARITHMETIC: Final[dict[type[ast.operator], Callable[[Any, Any], Any]]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Mod: operator.mod,
    ast.BitAnd: operator.and_,
    ast.BitOr: operator.or_,
    ast.BitXor: operator.xor,
    ast.LShift: operator.lshift,
    ast.RShift: operator.rshift,
}
_SIGNS: Final[dict[type[ast.unaryop], Callable[[Any], Any]]] = {
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
    ast.Invert: operator.invert,
}


class Filter:
    """A compiled expression; ProfidriveError has the position and the error."""

    def __init__(self, text: str, names: Names) -> None:
        self.text = text
        self._names = names
        self._signals: dict[str, Getter] = {}
        """The signals of the expression by their spelling."""
        self._held: dict[tuple[int, int], dict[str, Value]] = {}
        """Their last values of each axis, or of each node that is none's."""
        self._present: dict[str, Value] = {}
        if len(text) > _MAX_LENGTH:
            raise ProfidriveError("filter", f"{len(text)} characters", f"at most {_MAX_LENGTH}")
        try:
            tree = ast.parse(text.strip(), mode="eval")
            self._evaluate = self._compile(tree.body)
        except SyntaxError as error:
            column = error.offset or len(text.strip()) + 1
            raise ProfidriveError(f"filter at column {column}", text, f"an expression ({error.msg})") from None
        except (RecursionError, MemoryError, ValueError) as error:
            if isinstance(error, ProfidriveError):
                raise
            raise ProfidriveError(
                "filter", text[:60], f"a simpler expression ({error or type(error).__name__})"
            ) from None

    def matches(self, record: Record, unit: ProcessData | None) -> bool:
        """Whether the expression is true of one unit of a packet (None: a packet without units)."""
        if unit is not None and len(self._signals) > 1:
            self._hold(record, unit)
        return bool(self._evaluate(record, unit))

    def _hold(self, record: Record, unit: ProcessData) -> None:
        """Remember the signals of a unit; the others are those of before where it has any, else unknown."""
        values: dict[str, Value] = {
            name: value for name, get in self._signals.items() if (value := get(record, unit)) is not None
        }
        self._present = values
        if values:
            held = self._held.setdefault((unit.axis, 0 if unit.axis else unit.node), {})
            held.update(values)
            self._present = held

    def select(self, record: Record) -> tuple[ProcessData, ...] | None:
        """The units of a packet that match; None when the packet does not."""
        units = record.units
        if not units:
            return () if self.matches(record, None) else None
        return tuple(unit for unit in units if self.matches(record, unit)) or None

    # -- compilation -----------------------------------------------------------------------------------------------

    def _compile(self, node: ast.expr) -> Evaluate:
        if isinstance(node, ast.BoolOp):
            return _all_or_any([self._compile(part) for part in node.values], isinstance(node.op, ast.And))
        if isinstance(node, ast.UnaryOp):
            return self._unary(node)
        if isinstance(node, ast.Compare):
            return self._compare(node)
        if isinstance(node, ast.BinOp):
            return self._arithmetic(node)
        if isinstance(node, ast.Name):
            return self._name(node.id)
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            return self._name(f"{node.value.id}.{node.attr}")
        if isinstance(node, ast.Constant) and isinstance(node.value, int | float | str):
            value = _plain(node.value)
            return lambda _record, _unit: value
        if isinstance(node, ast.Tuple | ast.List | ast.Set):
            parts = [self._compile(part) for part in node.elts]
            return lambda record, unit: tuple(_plain(part(record, unit)) for part in parts)
        raise _refused(node, "names, numbers, texts, comparisons, and, or, not")

    def _name(self, text: str) -> Evaluate:
        get = self._names.getter(text)
        if self._names.split(text)[0] in RECORD_NAMES:
            return get
        self._signals[text] = get

        def evaluate(record: Record, unit: ProcessData | None) -> Value:
            if unit is None or len(self._signals) == 1:
                return get(record, unit)
            return self._present.get(text)

        return evaluate

    def _unary(self, node: ast.UnaryOp) -> Evaluate:
        inner = self._compile(node.operand)
        if isinstance(node.op, ast.Not):
            return lambda record, unit: None if (value := inner(record, unit)) is None else not value
        sign = _SIGNS[type(node.op)]
        return lambda record, unit: _apply(node, sign, inner(record, unit))

    def _compare(self, node: ast.Compare) -> Evaluate:
        operands = [self._compile(part) for part in (node.left, *node.comparators)]
        operators = []
        for item, right in zip(node.ops, node.comparators, strict=True):
            if type(item) not in _COMPARISONS:
                raise _refused(node, "==, !=, <, <=, >, >=, in")
            if isinstance(item, ast.In | ast.NotIn) and not isinstance(right, ast.Tuple | ast.List | ast.Set):
                raise _refused(node, "a list after in, like axis in (1, 2)")
            operators.append(_COMPARISONS[type(item)])

        def evaluate(record: Record, unit: ProcessData | None) -> bool | None:
            left = _plain(operands[0](record, unit))
            for compare, operand in zip(operators, operands[1:], strict=True):
                right = _plain(operand(record, unit))
                if left is None or right is None:
                    return None
                try:
                    if not compare(left, right):
                        return False
                except TypeError:
                    raise ProfidriveError("filter", f"{left!r} and {right!r}", "values that can be compared") from None
                left = right
            return True

        return evaluate

    def _arithmetic(self, node: ast.BinOp) -> Evaluate:
        if type(node.op) not in _ARITHMETIC:
            raise _refused(node, "+, -, *, /, %, &, |, ^, <<, >>")
        left, right = self._compile(node.left), self._compile(node.right)
        apply = _ARITHMETIC[type(node.op)]
        shifts = isinstance(node.op, ast.LShift | ast.RShift)

        def evaluate(record: Record, unit: ProcessData | None) -> Any:
            one, other = left(record, unit), right(record, unit)
            if one is not None and other is not None and shifts and not 0 <= _number(node, other) <= _MAX_SHIFT:
                raise _refused(node, f"a shift by 0 to {_MAX_SHIFT}")
            return _apply(node, apply, one, other)

        return evaluate


def _plain(value: Any) -> Any:
    return value.casefold() if isinstance(value, str) else value


def _number(node: ast.expr, value: Any) -> int | float:
    if not isinstance(value, int | float):
        raise _refused(node, "numbers in an arithmetic operation")
    return value


def _apply(node: ast.expr, function: Callable[..., Any], *values: Any) -> Any:
    if any(value is None for value in values):
        return None
    try:
        return function(*(_number(node, value) for value in values))
    except (TypeError, ZeroDivisionError, OverflowError) as error:
        raise ProfidriveError("filter", ast.unparse(node), f"a possible calculation ({error})") from None


def _all_or_any(parts: list[Evaluate], conjunction: bool) -> Evaluate:
    """``and`` / ``or`` of three values: one that decides wins over unknown."""

    def evaluate(record: Record, unit: ProcessData | None) -> bool | None:
        result: bool | None = conjunction
        for part in parts:
            value = part(record, unit)
            if value is None:
                result = None
            elif bool(value) is not conjunction:
                return not conjunction
        return result

    return evaluate


def _refused(node: ast.expr, allowed: str) -> ProfidriveError:
    return ProfidriveError(f"filter at column {node.col_offset + 1}", ast.unparse(node), allowed)


class Changes:
    """Remembers the last values of every stream (FrameID, COB-ID); memory grows with their number only."""

    def __init__(self) -> None:
        self._last: dict[object, ProcessData] = {}
        self._rest: dict[object, object] = {}
        """The compared data besides the units."""

    def select(self, record: Record, units: tuple[ProcessData, ...]) -> tuple[ProcessData, ...] | None:
        """The units reduced to the signals that changed; None when the packet says nothing new.

        New is another value, IOPS, IOCS or status of a cyclic frame, another NMT state, other bytes where no layout is known,
        and the first SYNC; services and errors always are.
        """
        changed = tuple(part for unit in units if (part := self._unit(record, unit)) is not None)
        rest = _compared(record, bool(units))
        if rest is None:
            return changed or (None if units else ())
        key = (record.channel, record.stream)
        before = self._rest.get(key)
        self._rest[key] = rest
        return changed or (None if before == rest else ())

    def _unit(self, record: Record, unit: ProcessData) -> ProcessData | None:
        key = (record.channel, record.stream, unit.axis, unit.node)
        before = self._last.get(key)
        self._last[key] = unit
        if before is None or before.layout is not unit.layout:
            return unit
        changed = [i for i, (old, new) in enumerate(zip(before.values, unit.values, strict=True)) if old != new]
        if not changed and (before.iops, before.iocs) == (unit.iops, unit.iocs):
            return None
        return reduced(unit, changed)


def _compared(record: Record, has_units: bool) -> object | None:
    """Data whose change makes a packet new besides its units; None if it is always new or never."""
    if isinstance(record, CyclicRecord):
        status = (record.data_status, record.transfer_status)
        return status if has_units else (*status, record.data[: -TRAILER.size])
    if isinstance(record, HeartbeatRecord):
        return record.state
    if isinstance(record, SyncRecord):
        return "sync"
    return record.data if type(record) is CanRecord else None


@lru_cache(maxsize=4096)
def _reduced_layout(layout: ProcessDataLayout, positions: tuple[int, ...]) -> ProcessDataLayout:
    return ProcessDataLayout(tuple(layout.fields[i] for i in positions), layout.telegram, layout.direction)


def reduced(unit: ProcessData, positions: Sequence[int]) -> ProcessData:
    """The unit with only these of its values."""
    chosen = tuple(positions)
    layout = _reduced_layout(unit.layout, chosen)
    return ProcessData(unit.axis, unit.node, layout, tuple(unit.values[i] for i in chosen), unit.iops, unit.iocs)
