"""Compile Structured Text to Python in one pass. Every type is checked; only explicit conversions are done.

Each unit becomes a function of its variables, a dictionary named ``v`` in the generated text. Supported: TYPE with STRUCT,
PROGRAM, FUNCTION_BLOCK, FUNCTION; assignment, IF, CASE, FOR, WHILE, calls of blocks: what the generated code has.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from typing import Any, Final, NamedTuple

from pdgw.base.durations import MS, SECOND
from pdgw.tools.plc.declarations import StructuredTextError, Token, pieces
from tests.support.structured_text import types
from tests.support.structured_text.functions import FUNCTIONS, blocks, conversion

SECTIONS = ("VAR_INPUT", "VAR_OUTPUT", "VAR_IN_OUT", "VAR")
_UNITS = ("PROGRAM", "FUNCTION_BLOCK", "FUNCTION")
_TIME_UNITS = {"d": 86_400 * SECOND, "h": 3600 * SECOND, "m": 60 * SECOND, "s": SECOND, "ms": MS}
_LEVELS: Final[tuple[dict[str, str], ...]] = (
    {"OR": "{} | {}"},
    {"AND": "{} & {}"},
    {"=": "{} == {}", "<>": "{} != {}"},
    {"<": "{} < {}", ">": "{} > {}", "<=": "{} <= {}", ">=": "{} >= {}"},
    {"+": "{} + {}", "-": "{} - {}"},
    {"*": "{} * {}", "/": "quotient({}, {})", "MOD": "remainder({}, {})"},
)
"""The operators from lowest to highest precedence, with the Python expression of each."""
_LOGIC, _COMPARISON, _SUM = 2, 4, 4
"""End of the levels of logic and of comparisons; the level of sums."""
_LOOPS_AT_MOST = 100_000


_FAILURES = (ZeroDivisionError, OverflowError, ValueError, IndexError)
_REAL = struct.Struct("<f")


class Expression(NamedTuple):
    """A value as Python text. ``writable``: the text can be assigned to."""

    type: types.Type
    code: str
    writable: bool = False
    constant: types.Value = None


def _quotient(dividend: Any, divisor: Any) -> Any:
    """Quotient; integers are rounded towards zero as in the standard."""
    if isinstance(dividend, float):
        return dividend / divisor
    return abs(dividend) // abs(divisor) * (1 if (dividend < 0) == (divisor < 0) else -1)


def _place(index: int, low: int, high: int) -> int:
    """Position of an array element in its list; IndexError outside the bounds."""
    if not low <= index <= high:
        raise IndexError(f"index {index} is outside {low}..{high}")
    return index - low


_NAMES: Final[dict[str, Any]] = {
    "quotient": _quotient,
    "remainder": lambda dividend, divisor: dividend - divisor * _quotient(dividend, divisor),
    "place": _place,
    "real": lambda value: _REAL.unpack(_REAL.pack(value))[0],
    "copied": types.copied,
    "Failed": StructuredTextError,
    "failures": _FAILURES,
    **{f"standard_{name}": rule.does for name, rule in FUNCTIONS.items()},
}
"""Names that the Python text uses, besides its own units."""


def duration(text: str) -> int:
    """Nanoseconds of the text after ``T#``, such as ``1h2m3.5s``; 0 for an empty text."""
    parts = re.findall(r"([\d_.]+)(ms|d|h|m|s)", text.lower())
    total = sum(float(number.replace("_", "")) * _TIME_UNITS[unit] for number, unit in parts)
    return round(-total if text.startswith("-") else total)


class Compiler:
    """``units`` and ``structures``: compiled ones by name in upper case. StructuredTextError names the line."""

    def __init__(self, now: Callable[[], int], *texts: str) -> None:
        """``texts`` are compiled in order."""
        self.structures: dict[str, types.Structure] = {}
        self.units: dict[str, types.Unit] = blocks(now)
        self._tokens = [token for text in texts for token in pieces(text) if token.kind not in {"space", "comment"}]
        self._tokens.append(Token("end", "", self._tokens[-1].line if self._tokens else "line 1"))
        self._at = 0
        self._unit = types.Unit("", "", {})
        self._names: dict[str, Any] = {**_NAMES, **{f"body_{name}": unit.body for name, unit in self.units.items()}}
        self._lines: list[tuple[str, str]] = []
        """The Python text of the present unit, each line with the source line it comes from."""
        self._depth = 0
        self._numbers = count()
        while self._token.kind != "end":
            self._declaration()

    # -- tokens -------------------------------------------------------------------------------------------------------

    @property
    def _token(self) -> Token:
        return self._tokens[self._at]

    def _error(self, text: str) -> StructuredTextError:
        return StructuredTextError(f"{self._token.line}: {text}")

    def _next(self) -> Token:
        self._at += 1
        return self._tokens[self._at - 1]

    def _accept(self, *keys: str) -> str:
        """If the present token is one of these, move to the next one and return its key; else return an empty text."""
        return self._next().key if self._token.key in keys else ""

    def _expect(self, *keys: str) -> str:
        key = self._accept(*keys)
        if not key:
            raise self._error(f"{self._token.text!r}: expected {' or '.join(keys)}")
        return key

    def _name(self) -> str:
        if self._token.kind != "word":
            raise self._error(f"{self._token.text!r}: expected a name")
        return self._next().key

    # -- declarations -------------------------------------------------------------------------------------------------

    def _declaration(self) -> None:
        kind = self._expect("TYPE", *_UNITS)
        if kind == "TYPE":
            while not self._accept("END_TYPE"):
                self._structure()
        else:
            self._program_unit(kind)

    def _structure(self) -> None:
        name = self._new_name()
        self._expect(":")
        self._expect("STRUCT")
        structure = types.Structure(name, {})
        while not self._accept("END_STRUCT"):
            self._variable(structure.fields, "")
        self._expect(";")
        self.structures[name] = structure

    def _new_name(self) -> str:
        name = self._name()
        if name in self.structures or name in self.units or name in types.ELEMENTARY or name in FUNCTIONS:
            raise self._error(f"{name} is already declared")
        return name

    def _program_unit(self, kind: str) -> None:
        unit = self._unit = types.Unit(kind, self._new_name(), {})
        if kind == "FUNCTION":
            self._expect(":")
            unit.result = self._type()
            unit.variables[unit.name] = types.Variable(unit.result, "VAR")
        while section := self._accept(*SECTIONS):
            while not self._accept("END_VAR"):
                self._variable(unit.variables, section)
        self._lines = []
        self._emit("def body(v):")
        with self._deeper(), self._guarded():
            self._statements(f"END_{kind}")
        self._next()
        unit.body = self._names[f"body_{unit.name}"] = self._compiled()
        if kind == "FUNCTION":
            self._names[f"call_{unit.name}"] = _calling(unit)
        self.units[unit.name] = unit

    def _emit(self, text: str, line: str = "") -> None:
        """Add a Python line; its source line is that of the present token unless given."""
        self._lines.append((" " * self._depth + text, line or self._token.line))

    @contextmanager
    def _deeper(self) -> Iterator[None]:
        """Indent the following lines; add ``pass`` if there are none."""
        before = len(self._lines)
        self._depth += 1
        yield
        if len(self._lines) == before:
            self._emit("pass")
        self._depth -= 1

    @contextmanager
    def _guarded(self) -> Iterator[None]:
        """Report an error at run time with the line of its statement."""
        self._emit("try:")
        with self._deeper():
            yield
        self._emit("except failures as error:")
        self._emit(" raise Failed(f'{lines[error.__traceback__.tb_lineno]}: {error}') from error")

    def _compiled(self) -> Callable[[types.Variables], None]:
        """The function of the added lines."""
        names = self._names | {"lines": ["", *(line for _, line in self._lines)]}
        try:
            exec("\n".join(text for text, _ in self._lines), names)
        except (SyntaxError, RecursionError, MemoryError) as error:
            raise self._error(f"the statements or parentheses of {self._unit.name} are nested too deep") from error
        body: Callable[[types.Variables], None] = names["body"]
        return body

    def _variable(self, into: dict[str, types.Variable], section: str) -> None:
        names = [self._name()]
        while self._accept(","):
            names.append(self._name())
        self._expect(":")
        type_ = self._type()
        start = None
        if self._accept(":="):
            start = self._fitting(self._expression(), type_).constant
            if start is None:
                raise self._error("an initial value must be a constant")
        self._expect(";")
        for name in names:
            if name in into or name in self.units:
                raise self._error(f"{name} is already declared")
            into[name] = types.Variable(type_, section, start)

    def _type(self) -> types.Type:
        name = self._name()
        if name == "ARRAY":
            self._expect("[")
            low = self._integer()
            self._expect("..")
            high = self._integer()
            self._expect("]")
            self._expect("OF")
            return types.Array(low, high, self._type())
        found = types.ELEMENTARY.get(name) or self.structures.get(name) or self.units.get(name)
        if found is None or (isinstance(found, types.Unit) and found.kind != "FUNCTION_BLOCK"):
            raise self._error(f"{name}: unknown type (it must be declared before its use)")
        return found

    def _integer(self) -> int:
        value = self._fitting(self._expression(), types.ELEMENTARY["LINT"]).constant
        if value is None:
            raise self._error("expected an integer")
        return int(value)

    # -- statements ---------------------------------------------------------------------------------------------------

    def _statements(self, *ends: str, labelled: bool = False) -> None:
        """Compile statements up to one of ``ends``. ``labelled``: or to the next CASE label, an integer at the start of a
        statement.
        """
        while not (
            self._token.key in ends or (labelled and (self._token.kind == "integer" or self._token.text == "-"))
        ):
            if self._token.kind == "end":
                raise self._error(f"expected {' or '.join(ends)}")
            if not self._accept(";"):
                self._statement()

    def _statement(self) -> None:
        key = self._accept("IF", "CASE", "FOR", "WHILE")
        if key == "IF":
            self._if()
        elif key == "CASE":
            self._case()
        elif key == "FOR":
            self._for()
        elif key == "WHILE":
            self._while()
        else:
            self._assignment_or_call()

    def _assignment_or_call(self) -> None:
        line = self._token.line
        target = self._path(self._name())
        if isinstance(target.type, types.Unit):
            self._call(target.type, target.code)
            self._expect(";")
            return
        self._expect(":=")
        value = self._fitting(self._expression(), target.type).code
        self._expect(";")
        if not target.writable:
            raise self._error("cannot be assigned to")
        self._emit(f"{target.code} = {_copy(target.type, value)}", line)

    def _if(self) -> None:
        key = "IF"
        while key in {"IF", "ELSIF"}:
            word = "if" if key == "IF" else "elif"
            self._emit(f"{word} {self._fitting(self._expression(), types.BOOL).code}:")
            self._expect("THEN")
            with self._deeper():
                self._statements("ELSIF", "ELSE", "END_IF")
            key = self._next().key
        if key == "ELSE":
            self._emit("else:")
            with self._deeper():
                self._statements("END_IF")
            self._next()
        self._expect(";")

    def _case(self) -> None:
        selector = self._expression()
        if not _is_whole(selector.type):
            raise self._error("CASE needs an integer")
        self._expect("OF")
        chosen = f"n{next(self._numbers)}"
        self._emit(f"{chosen} = {selector.code}")
        known: set[int] = set()
        word = "if"
        while self._token.key not in {"ELSE", "END_CASE"}:
            values = [self._integer()]
            while self._accept(","):
                values.append(self._integer())
            self._expect(":")
            for value in values:
                if value in known:
                    raise self._error(f"CASE contains {value} twice")
                known.add(value)
            self._emit(f"{word} {chosen} in {(*values,)}:")
            word = "elif"
            with self._deeper():
                self._statements("ELSE", "END_CASE", labelled=True)
        if self._accept("ELSE"):
            self._emit("else:" if known else "if True:")
            with self._deeper():
                self._statements("END_CASE")
        self._expect("END_CASE")
        self._expect(";")

    def _for(self) -> None:
        counter = self._path(self._name())
        self._expect(":=")
        first = self._fitting(self._expression(), counter.type).code
        self._expect("TO")
        last = self._fitting(self._expression(), counter.type).code
        if not counter.writable:
            raise self._error("FOR needs a variable")
        number, end = f"n{next(self._numbers)}", f"n{next(self._numbers)}"
        self._emit(f"{end} = {last}")
        self._emit(f"{number} = {first}")
        self._emit(f"while {number} <= {end}:")
        self._expect("DO")
        with self._deeper():
            self._emit(f"{counter.code} = {number}")
            self._body_of_a_loop("END_FOR")
            self._emit(f"{number} += 1")

    def _while(self) -> None:
        line = self._token.line
        self._emit(f"for _ in range({_LOOPS_AT_MOST}):")
        with self._deeper():
            self._emit(f"if not {self._fitting(self._expression(), types.BOOL).code}: break")
            self._expect("DO")
            self._body_of_a_loop("END_WHILE")
        self._emit("else:")
        self._emit(f" raise Failed({f'{line}: the loop does not end'!r})")

    def _body_of_a_loop(self, end: str) -> None:
        self._statements(end)
        self._next()
        self._expect(";")

    # -- calls --------------------------------------------------------------------------------------------------------

    def _call(self, unit: types.Unit, instance: str) -> None:
        """Call a block with named arguments: assign inputs, run the body, copy outputs."""
        own = f"n{next(self._numbers)}"
        self._emit(f"{own} = {instance}")
        after: list[str] = []
        references = set(unit.section("VAR_IN_OUT"))
        self._expect("(")
        while not self._accept(")"):
            name = self._name()
            variable = unit.variables.get(name)
            if variable is None or variable.section not in {"VAR_INPUT", "VAR_OUTPUT", "VAR_IN_OUT"}:
                raise self._error(f"{unit.name} has no parameter {name}")
            if self._expect(":=", "=>") == ":=":
                given = self._fitting(self._expression(), variable.type)
                if variable.section == "VAR_OUTPUT":
                    raise self._error(f"{name} is an output: write => instead of :=")
                references.discard(name)
                by_reference = variable.section == "VAR_IN_OUT"
                if by_reference and isinstance(variable.type, types.Elementary):
                    raise self._error(f"{name}: VAR_IN_OUT is supported for structures and arrays only")
                self._emit(f"{own}[{name!r}] = {given.code if by_reference else _copy(given.type, given.code)}")
            else:
                target = self._path(self._name())
                if variable.section != "VAR_OUTPUT" or target.type != variable.type or not target.writable:
                    raise self._error(f"{name} cannot be assigned to a {target.type.name}")
                after.append(f"{target.code} = {_copy(target.type, f'{own}[{name!r}]')}")
            if self._token.key != ")":
                self._expect(",")
        if references:
            raise self._error(f"{unit.name} needs {', '.join(sorted(references))}")
        self._emit(f"body_{unit.name}({own})")
        for text in after:
            self._emit(text)

    def _function(self, name: str) -> Expression:
        """Call a function with named or positional arguments."""
        arguments: list[tuple[str, Expression]] = []
        self._expect("(")
        while not self._accept(")"):
            named = self._tokens[self._at + 1].text == ":="
            key = self._name() if named else ""
            if named:
                self._next()
            arguments.append((key, self._expression()))
            if self._token.key != ")":
                self._expect(",")
        change = conversion(name)
        if change is not None:
            source, target, does = change
            self._names[f"standard_{name}"] = does
            value = self._fitting(self._bound(arguments, ("IN",), name)["IN"], source).code
            return Expression(target, f"standard_{name}({value})")
        if name in FUNCTIONS:
            return self._standard(name, arguments)
        unit = self.units.get(name)
        if unit is None or unit.result is None:
            raise self._error(f"{name}: unknown function")
        given = ", ".join(
            f"{key!r}: {self._fitting(item, unit.variables[key].type).code}"
            for key, item in self._bound(arguments, tuple(unit.section("VAR_INPUT")), name).items()
        )
        return Expression(unit.result, f"call_{name}({{{given}}})")

    def _bound(
        self, arguments: list[tuple[str, Expression]], names: tuple[str, ...], function: str
    ) -> dict[str, Expression]:
        if len(arguments) != len(names):
            raise self._error(f"{function} takes {len(names)} arguments: {', '.join(names)}")
        bound = {key or names[place]: item for place, (key, item) in enumerate(arguments)}
        if set(bound) != set(names):
            raise self._error(f"{function} takes {', '.join(names)}")
        return bound

    def _standard(self, name: str, arguments: list[tuple[str, Expression]]) -> Expression:
        rule = FUNCTIONS[name]
        bound = self._bound(arguments, rule.parameters, name)
        type_ = next(
            (bound[key].type for key in rule.parameters if key in rule.like and bound[key].constant is None),
            next(bound[key].type for key in rule.parameters if key in rule.like),
        )
        if not isinstance(type_, types.Elementary) or type_.kind not in rule.kinds:
            raise self._error(f"{name} does not accept a {type_.name}")
        values = ", ".join(
            self._fitting(bound[key], type_ if key in rule.like else types.ELEMENTARY[rule.others[key]]).code
            for key in rule.parameters
        )
        return Expression(type_, _cut(type_, f"standard_{name}({values})"))

    # -- expressions --------------------------------------------------------------------------------------------------

    def _fitting(self, given: Expression, type_: types.Type) -> Expression:
        """The same expression as this type: a literal is converted, any other must have the type."""
        if given.type is type_ or given.type == type_ or (isinstance(type_, types.Array) and given.type == type_):
            return given
        if isinstance(type_, types.Elementary) and isinstance(given.type, types.Elementary):
            whole = type_.kind in {types.Kind.BITS, types.Kind.SIGNED, types.Kind.UNSIGNED}
            fits = (given.type is types.INTEGER_LITERAL and whole) or (
                given.type is types.REAL_LITERAL and type_.kind is types.Kind.REAL
            )
            if fits and given.constant is None:
                return given._replace(type=type_)  # the better of two literal types
            if fits and type_.holds(given.constant):
                return _literal(type_, type_.cut(given.constant))
        shown = given.type.name if given.constant is None else f"{given.type.name} {given.constant}"
        raise self._error(f"{shown} where {type_.name} is expected: convert it")

    def _expression(self, level: int = 0) -> Expression:
        if level == len(_LEVELS):
            return self._unary()
        found = self._expression(level + 1)
        chain = found.code
        while sign := self._accept(*_LEVELS[level]):
            found, code = self._binary(found._replace(code=chain), sign, self._expression(level + 1), level)
            # A sum of integers is cut once at its end. The result is the same, with fewer parentheses.
            uncut = level < _LOGIC or (level == _SUM and _is_whole(found.type))
            chain = code if uncut else found.code
        return found

    def _binary(self, left: Expression, sign: str, right: Expression, level: int) -> tuple[Expression, str]:
        """The value, and its text before it is cut."""
        if left.type in {types.INTEGER_LITERAL, types.REAL_LITERAL}:
            left = self._fitting(left, right.type)
        right = self._fitting(right, left.type)
        type_ = left.type
        if not isinstance(type_, types.Elementary) or not _fits(type_.kind, sign, level):
            raise self._error(f"{sign} does not accept a {type_.name}")
        code = _LEVELS[level][sign].format(left.code, right.code)
        if level < _LOGIC:
            return Expression(type_, f"({code})"), code
        return Expression(types.BOOL, f"({code})") if level < _COMPARISON else Expression(
            type_, _cut(type_, code)
        ), code

    def _unary(self) -> Expression:
        sign = self._accept("NOT", "-")
        if not sign:
            return self._primary()
        given = self._unary()
        type_ = given.type
        if sign == "-" and given.constant is not None:
            return given._replace(code=_text(-given.constant), constant=-given.constant)
        allowed = {types.Kind.BOOL, types.Kind.BITS} if sign == "NOT" else {types.Kind.SIGNED, types.Kind.REAL}
        if not isinstance(type_, types.Elementary) or type_.kind not in allowed:
            raise self._error(f"{sign} does not accept a {type_.name}")
        if sign == "NOT" and type_.kind is types.Kind.BOOL:
            return Expression(type_, f"(not {given.code})")
        return Expression(type_, _cut(type_, f"{'~' if sign == 'NOT' else '-'}{given.code}"))

    def _primary(self) -> Expression:
        if self._accept("("):
            found = self._expression()
            self._expect(")")
            return found
        token = self._next()
        if token.kind == "word":
            if token.key in {"TRUE", "FALSE"}:
                return _literal(types.BOOL, token.key == "TRUE")
            if self._token.text == "(" and token.key not in self._unit.variables:
                return self._function(token.key)
            return self._path(token.key)
        if token.kind == "integer":
            *heads, digits = token.key.replace("_", "").split("#")
            base = int(heads.pop()) if heads and heads[-1].isdigit() else 10
            literal = _literal(types.INTEGER_LITERAL, int(digits, base))
            if heads and heads[0] not in types.ELEMENTARY:
                raise self._error(f"{heads[0]}# is not a type")
            return self._fitting(literal, types.ELEMENTARY[heads[0]]) if heads else literal
        if token.kind == "real":
            return _literal(types.REAL_LITERAL, float(token.text.replace("_", "")))
        if token.kind == "time":
            return _literal(types.TIME, duration(token.text.partition("#")[2]))
        if token.kind == "string":
            return _literal(types.ELEMENTARY["STRING"], re.sub(r"\$(.)", r"\1", token.text[1:-1]))
        self._at -= 1
        raise self._error(f"{token.text!r}: expected a value")

    def _path(self, name: str) -> Expression:
        """A variable, a field of it, or an element of it."""
        variable = self._unit.variables.get(name)
        if variable is None:
            raise self._error(f"{name} is not declared in {self._unit.name}")
        found = Expression(variable.type, f"v[{name!r}]", variable.section != "VAR_INPUT")
        while sign := self._accept(".", "["):
            found = self._field(found) if sign == "." else self._element(found)
        return found

    def _field(self, of: Expression) -> Expression:
        name = self._name()
        fields = of.type.fields if isinstance(of.type, types.Structure) else {}
        if isinstance(of.type, types.Unit):
            fields = {
                key: item for key, item in of.type.variables.items() if item.section in {"VAR_INPUT", "VAR_OUTPUT"}
            }
        if name not in fields:
            raise self._error(f"{of.type.name} has no {name}")
        # A block writes its own outputs; its inputs are read-only.
        writable = of.writable and not (isinstance(of.type, types.Unit) and fields[name].section == "VAR_OUTPUT")
        return Expression(fields[name].type, f"{of.code}[{name!r}]", writable)

    def _element(self, of: Expression) -> Expression:
        index = self._expression()
        self._expect("]")
        if not isinstance(of.type, types.Array):
            raise self._error(f"{of.type.name} is not an array")
        if index.type is types.INTEGER_LITERAL:
            index = self._fitting(index, types.ELEMENTARY["DINT"])
        low, high = of.type.low, of.type.high
        inside = index.constant is not None and low <= index.constant <= high
        place = index.constant - low if inside else f"place({index.code}, {low}, {high})"
        return Expression(of.type.element, f"{of.code}[{place}]", of.writable)


def _literal(type_: types.Elementary, value: types.Value) -> Expression:
    return Expression(type_, _text(value), False, value)


def _text(value: types.Value) -> str:
    """A constant as Python text."""
    if isinstance(value, float) and not math.isfinite(value):
        return f"float('{value}')"
    return f"({value!r})"


def _cut(type_: types.Elementary, code: str) -> str:
    """The text that cuts a result to the range of its type, like ``type_.cut``."""
    mask, half = (1 << type_.bits) - 1, 1 << type_.bits >> 1
    if type_.kind in {types.Kind.BITS, types.Kind.UNSIGNED}:
        return f"({code} & {mask})"
    if type_.kind is types.Kind.SIGNED:
        return f"(({code} + {half} & {mask}) - {half})"
    return f"real({code})" if type_.kind is types.Kind.REAL and type_.bits == 32 else f"({code})"


def _copy(type_: types.Type, code: str) -> str:
    """The text that copies a structure or an array for an assignment."""
    return code if isinstance(type_, types.Elementary) else f"copied({code})"


def _calling(unit: types.Unit) -> Callable[[types.Variables], types.Value]:
    """A Python function of its arguments by name; each call has its own variables."""

    def call(given: types.Variables) -> types.Value:
        own = unit.initial
        own.update(given)
        unit.body(own)
        return own[unit.name]

    return call


def _is_whole(type_: types.Type) -> bool:
    return isinstance(type_, types.Elementary) and type_.kind in {types.Kind.SIGNED, types.Kind.UNSIGNED}


def _fits(kind: types.Kind, sign: str, level: int) -> bool:
    if level < _LOGIC:
        return kind in {types.Kind.BOOL, types.Kind.BITS}
    if level < _COMPARISON:
        return sign in {"=", "<>"} or kind not in {types.Kind.BOOL, types.Kind.BITS}
    if kind is types.Kind.TIME:
        return sign in {"+", "-"}
    return kind in {types.Kind.SIGNED, types.Kind.UNSIGNED} or (kind is types.Kind.REAL and sign != "MOD")
