"""Structured Text to functions of Python: one pass, every type checked, no conversion that the text does not ask for.

Supported: TYPE with STRUCT, PROGRAM, FUNCTION_BLOCK, FUNCTION; assignment, IF, CASE, FOR, WHILE, EXIT, RETURN, calls of blocks.
Left out: global and directly represented variables, enumerations, pointers, REPEAT. A CONFIGURATION is skipped.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Sequence
from itertools import zip_longest
from typing import NamedTuple

from pdgw.durations import MS, SECOND
from pdgw.peers.plc.structured_text.functions import FUNCTIONS, blocks, conversion
from pdgw.peers.plc.structured_text.tokens import StructuredTextError, Token, tokens
from pdgw.peers.plc.structured_text.types import (
    BOOL,
    ELEMENTARY,
    INTEGER_LITERAL,
    REAL_LITERAL,
    TIME,
    Array,
    Elementary,
    Kind,
    Structure,
    Type,
    Unit,
    Value,
    Variable,
    Variables,
    copied,
)

Evaluate = Callable[[Variables], Value]
Execute = Callable[[Variables], None]
SECTIONS = ("VAR_INPUT", "VAR_OUTPUT", "VAR_IN_OUT", "VAR", "VAR_TEMP")
_UNITS = ("PROGRAM", "FUNCTION_BLOCK", "FUNCTION")
_TIME_UNITS = {"d": 86_400 * SECOND, "h": 3600 * SECOND, "m": 60 * SECOND, "s": SECOND, "ms": MS}
_LEVELS: tuple[dict[str, Callable[[Value, Value], Value]], ...] = (
    {"OR": operator.or_},
    {"XOR": operator.xor},
    {"AND": operator.and_, "&": operator.and_},
    {"=": operator.eq, "<>": operator.ne},
    {"<": operator.lt, ">": operator.gt, "<=": operator.le, ">=": operator.ge},
    {"+": operator.add, "-": operator.sub},
    {
        "*": operator.mul,
        "/": lambda a, b: a / b if isinstance(a, float) else _quotient(a, b),
        "MOD": lambda a, b: a - b * _quotient(a, b),
    },
)
"""The operators from the weakest to the strongest."""
_LOGIC, _COMPARISON = 3, 5
"""Levels before these."""
_LOOPS_AT_MOST = 100_000


class Expression(NamedTuple):
    """A value; ``place`` where it can be assigned to: what it is in, and its key or index there."""

    type: Type
    value: Evaluate
    place: tuple[Evaluate, Evaluate] | None = None
    constant: Value = None


class _ExitError(Exception):
    """EXIT, inside of its loop."""


class _ReturnError(Exception):
    """RETURN, inside of its unit."""


def _quotient(dividend: int, divisor: int) -> int:
    """Towards zero, as the standard divides integers."""
    return abs(dividend) // abs(divisor) * (1 if (dividend < 0) == (divisor < 0) else -1)


def duration(text: str) -> int:
    """``1h2m3.5s``, as it is behind ``T#``, in nanoseconds; 0 for nothing."""
    parts = re.findall(r"([\d_.]+)(ms|d|h|m|s)", text.lower())
    total = sum(float(number.replace("_", "")) * _TIME_UNITS[unit] for number, unit in parts)
    return round(-total if text.startswith("-") else total)


class Compiler:
    """``units`` and ``structures`` by their names in upper case, once compiled. StructuredTextError has the line."""

    def __init__(self, now: Callable[[], int], *texts: str, files: Sequence[str] = ()) -> None:
        """``texts`` are read one after the other; ``files``: their names, for messages."""
        self.structures: dict[str, Structure] = {}
        self.units: dict[str, Unit] = blocks(now)
        self._tokens = [token for text, file in zip_longest(texts, files, fillvalue="") for token in tokens(text, file)]
        self._tokens.append(Token("end", "", self._tokens[-1].line if self._tokens else "line 1"))
        self._at = 0
        self._unit = Unit("", "", {})
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
        """The key of the present token when it is one of these, and the next one is present; else nothing."""
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
        kind = self._expect("TYPE", "CONFIGURATION", *_UNITS)
        if kind == "CONFIGURATION":
            while not self._accept("END_CONFIGURATION"):
                self._next()
        elif kind == "TYPE":
            while not self._accept("END_TYPE"):
                self._structure()
        else:
            self._program_unit(kind)

    def _structure(self) -> None:
        name = self._new_name()
        self._expect(":")
        self._expect("STRUCT")
        structure = Structure(name, {})
        while not self._accept("END_STRUCT"):
            self._variable(structure.fields, "")
        self._expect(";")
        self.structures[name] = structure

    def _new_name(self) -> str:
        name = self._name()
        if name in self.structures or name in self.units or name in ELEMENTARY or name in FUNCTIONS:
            raise self._error(f"{name} is already declared")
        return name

    def _program_unit(self, kind: str) -> None:
        unit = self._unit = Unit(kind, self._new_name(), {})
        if kind == "FUNCTION":
            self._expect(":")
            unit.result = self._type()
            unit.variables[unit.name] = Variable(unit.result, "VAR")
        while section := self._accept(*SECTIONS):
            constant = bool(self._accept("CONSTANT"))
            while not self._accept("END_VAR"):
                self._variable(unit.variables, section, constant=constant)
        body = self._statements(f"END_{kind}")
        self._next()
        temporary = {key: item for key, item in unit.variables.items() if item.section == "VAR_TEMP"}

        def execute(variables: Variables) -> None:
            for key, item in temporary.items():
                variables[key] = item.type.initial
            try:
                body(variables)
            except _ReturnError:
                return

        unit.body = execute
        self.units[unit.name] = unit

    def _variable(self, into: dict[str, Variable], section: str, *, constant: bool = False) -> None:
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
            into[name] = Variable(type_, section, start, constant)

    def _type(self) -> Type:
        name = self._name()
        if name == "ARRAY":
            self._expect("[")
            low = self._integer()
            self._expect("..")
            high = self._integer()
            self._expect("]")
            self._expect("OF")
            return Array(low, high, self._type())
        if name == "STRING" and self._accept("["):
            length = self._integer()
            self._expect("]")
            return Elementary("STRING", Kind.STRING, length)
        found = ELEMENTARY.get(name) or self.structures.get(name) or self.units.get(name)
        if found is None or (isinstance(found, Unit) and found.kind != "FUNCTION_BLOCK"):
            raise self._error(f"{name}: unknown type (it must be declared before its use)")
        return found

    def _integer(self) -> int:
        value = self._fitting(self._expression(), ELEMENTARY["LINT"]).constant
        if value is None:
            raise self._error("expected an integer")
        return int(value)

    # -- statements ---------------------------------------------------------------------------------------------------

    def _statements(self, *ends: str, labelled: bool = False) -> Execute:
        """Up to one of ``ends``; ``labelled``: or to the next label of a CASE, an integer where a statement would begin."""
        found: list[Execute] = []
        while not (
            self._token.key in ends or (labelled and (self._token.kind == "integer" or self._token.text == "-"))
        ):
            if self._token.kind == "end":
                raise self._error(f"expected {' or '.join(ends)}")
            if not self._accept(";"):
                found.append(self._statement())

        def execute(variables: Variables) -> None:
            for statement in found:
                statement(variables)

        return execute

    def _statement(self) -> Execute:
        key = self._accept("IF", "CASE", "FOR", "WHILE", "EXIT", "RETURN")
        if key == "IF":
            return self._if()
        if key == "CASE":
            return self._case()
        if key == "FOR":
            return self._for()
        if key == "WHILE":
            return self._while()
        if key:
            self._expect(";")
            return _raising(_ExitError if key == "EXIT" else _ReturnError)
        target = self._path(self._name())
        if isinstance(target.type, Unit):
            call = self._call(target.type, target.value)
            self._expect(";")
            return call
        self._expect(":=")
        value = self._fitting(self._expression(), target.type).value
        self._expect(";")
        if target.place is None:
            raise self._error("cannot be assigned to")
        container, place = target.place

        def assign(variables: Variables) -> None:
            container(variables)[place(variables)] = value(variables)

        def assign_copy(variables: Variables) -> None:
            container(variables)[place(variables)] = copied(value(variables))

        return assign if isinstance(target.type, Elementary) else assign_copy

    def _if(self) -> Execute:
        branches: list[tuple[Evaluate, Execute]] = []
        key = "IF"
        while key in {"IF", "ELSIF"}:
            condition = self._fitting(self._expression(), BOOL).value
            self._expect("THEN")
            branches.append((condition, self._statements("ELSIF", "ELSE", "END_IF")))
            key = self._next().key
        otherwise = self._statements("END_IF") if key == "ELSE" else None
        if otherwise is not None:
            self._next()
        self._expect(";")

        def execute(variables: Variables) -> None:
            for condition, body in branches:
                if condition(variables):
                    body(variables)
                    return
            if otherwise is not None:
                otherwise(variables)

        return execute

    def _case(self) -> Execute:
        selector = self._expression()
        if not isinstance(selector.type, Elementary) or selector.type.kind not in {Kind.SIGNED, Kind.UNSIGNED}:
            raise self._error("CASE needs an integer")
        self._expect("OF")
        branches: dict[int, Execute] = {}
        while self._token.key not in {"ELSE", "END_CASE"}:
            values = [self._integer()]
            while self._accept(","):
                values.append(self._integer())
            self._expect(":")
            body = self._statements("ELSE", "END_CASE", labelled=True)
            for value in values:
                if value in branches:
                    raise self._error(f"CASE contains {value} twice")
                branches[value] = body
        otherwise = self._statements("END_CASE") if self._accept("ELSE") else _nothing
        self._expect("END_CASE")
        self._expect(";")
        return lambda variables: branches.get(selector.value(variables), otherwise)(variables)

    def _for(self) -> Execute:
        counter = self._path(self._name())
        self._expect(":=")
        first = self._fitting(self._expression(), counter.type).value
        self._expect("TO")
        last = self._fitting(self._expression(), counter.type).value
        step = self._integer() if self._accept("BY") else 1
        self._expect("DO")
        body = self._statements("END_FOR")
        self._next()
        self._expect(";")
        if counter.place is None or not step:
            raise self._error("FOR needs a variable and a step other than 0")
        container, place = counter.place

        def execute(variables: Variables) -> None:
            end = last(variables)
            number = first(variables)
            while number <= end if step > 0 else number >= end:
                container(variables)[place(variables)] = number
                try:
                    body(variables)
                except _ExitError:
                    return
                number += step

        return execute

    def _while(self) -> Execute:
        line = self._token.line
        condition = self._fitting(self._expression(), BOOL).value
        self._expect("DO")
        body = self._statements("END_WHILE")
        self._next()
        self._expect(";")

        def execute(variables: Variables) -> None:
            for _ in range(_LOOPS_AT_MOST):
                if not condition(variables):
                    return
                try:
                    body(variables)
                except _ExitError:
                    return
            raise StructuredTextError(f"{line}: the loop does not end")

        return execute

    # -- calls --------------------------------------------------------------------------------------------------------

    def _call(self, unit: Unit, instance: Evaluate) -> Execute:
        """A call of a block with named arguments: inputs, then the body, then outputs."""
        before: list[tuple[str, Evaluate]] = []
        after: list[tuple[str, tuple[Evaluate, Evaluate]]] = []
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
                if by_reference and isinstance(variable.type, Elementary):
                    raise self._error(f"{name}: VAR_IN_OUT is supported for structures and arrays only")
                before.append((name, given.value if by_reference else _copying(given.value)))
            else:
                target = self._path(self._name())
                if variable.section != "VAR_OUTPUT" or target.type != variable.type or target.place is None:
                    raise self._error(f"{name} cannot be assigned to a {target.type.name}")
                after.append((name, target.place))
            if self._token.key != ")":
                self._expect(",")
        if references:
            raise self._error(f"{unit.name} needs {', '.join(sorted(references))}")

        def execute(variables: Variables) -> None:
            own = instance(variables)
            for name, value in before:
                own[name] = value(variables)
            unit.body(own)
            for name, (container, place) in after:
                container(variables)[place(variables)] = copied(own[name])

        return execute

    def _function(self, name: str) -> Expression:
        """A call of a function, its arguments with or without names."""
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
            value = self._fitting(self._bound(arguments, ("IN",), name)["IN"], source).value
            return Expression(target, lambda variables: does(value(variables)))
        if name in FUNCTIONS:
            return self._standard(name, arguments)
        unit = self.units.get(name)
        if unit is None or unit.result is None:
            raise self._error(f"{name}: unknown function")
        given = {
            key: self._fitting(item, unit.variables[key].type).value
            for key, item in self._bound(arguments, tuple(unit.section("VAR_INPUT")), name).items()
        }

        def call(variables: Variables) -> Value:
            own = unit.initial
            own.update({key: item(variables) for key, item in given.items()})
            unit.body(own)
            return own[unit.name]

        return Expression(unit.result, call)

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
        if not isinstance(type_, Elementary) or type_.kind not in rule.kinds:
            raise self._error(f"{name} does not accept a {type_.name}")
        values = [
            self._fitting(bound[key], type_ if key in rule.like else ELEMENTARY[rule.others[key]]).value
            for key in rule.parameters
        ]
        return Expression(type_, lambda variables: type_.cut(rule.does(*(value(variables) for value in values))))

    # -- expressions --------------------------------------------------------------------------------------------------

    def _fitting(self, given: Expression, type_: Type) -> Expression:
        """The same expression as this type: a literal takes it, anything else has it."""
        if given.type is type_ or given.type == type_ or (isinstance(type_, Array) and given.type == type_):
            return given
        if isinstance(type_, Elementary) and isinstance(given.type, Elementary):
            if type_.kind is Kind.STRING and given.type.kind is Kind.STRING:
                return given._replace(type=type_)
            whole = type_.kind in {Kind.BITS, Kind.SIGNED, Kind.UNSIGNED}
            fits = (given.type is INTEGER_LITERAL and whole) or (given.type is REAL_LITERAL and type_.kind is Kind.REAL)
            if fits and given.constant is None:
                return given._replace(type=type_)  # chosen among literals
            if fits and type_.holds(given.constant):
                value = type_.cut(given.constant)
                return Expression(type_, lambda _: value, None, value)
        shown = given.type.name if given.constant is None else f"{given.type.name} {given.constant}"
        raise self._error(f"{shown} where {type_.name} is expected: convert it")

    def _expression(self, level: int = 0) -> Expression:
        if level == len(_LEVELS):
            return self._unary()
        left = self._expression(level + 1)
        while sign := self._accept(*_LEVELS[level]):
            right = self._expression(level + 1)
            left = self._binary(left, sign, right, level)
        return left

    def _binary(self, left: Expression, sign: str, right: Expression, level: int) -> Expression:
        if left.type in {INTEGER_LITERAL, REAL_LITERAL}:
            left = self._fitting(left, right.type)
        right = self._fitting(right, left.type)
        type_ = left.type
        if not isinstance(type_, Elementary) or not _fits(type_.kind, sign, level):
            raise self._error(f"{sign} does not accept a {type_.name}")
        does, a, b, line = _LEVELS[level][sign], left.value, right.value, self._token.line
        if level < _LOGIC:
            return Expression(type_, lambda variables: does(a(variables), b(variables)))
        if level < _COMPARISON:
            return Expression(BOOL, lambda variables: does(a(variables), b(variables)))

        def calculate(variables: Variables) -> Value:
            try:
                return type_.cut(does(a(variables), b(variables)))
            except (ZeroDivisionError, OverflowError, ValueError) as error:
                raise StructuredTextError(f"{line}: {error}") from error

        return Expression(type_, calculate)

    def _unary(self) -> Expression:
        sign = self._accept("NOT", "-")
        if not sign:
            return self._primary()
        given = self._unary()
        type_, value = given.type, given.value
        if sign == "-" and given.constant is not None:
            constant = -given.constant
            return given._replace(value=lambda _: constant, constant=constant)
        allowed = {Kind.BOOL, Kind.BITS} if sign == "NOT" else {Kind.SIGNED, Kind.REAL}
        if not isinstance(type_, Elementary) or type_.kind not in allowed:
            raise self._error(f"{sign} does not accept a {type_.name}")
        if sign == "-":
            return Expression(type_, lambda variables: type_.cut(-value(variables)))
        if type_.kind is Kind.BOOL:
            return Expression(type_, lambda variables: not value(variables))
        return Expression(type_, lambda variables: type_.cut(~value(variables)))

    def _primary(self) -> Expression:
        if self._accept("("):
            found = self._expression()
            self._expect(")")
            return found
        token = self._next()
        if token.kind == "word":
            if token.key in {"TRUE", "FALSE"}:
                return _literal(BOOL, token.key == "TRUE")
            if self._token.text == "(" and token.key not in self._unit.variables:
                return self._function(token.key)
            return self._path(token.key)
        if token.kind == "integer":
            *heads, digits = token.key.replace("_", "").split("#")
            base = int(heads.pop()) if heads and heads[-1].isdigit() else 10
            literal = _literal(INTEGER_LITERAL, int(digits, base))
            if heads and heads[0] not in ELEMENTARY:
                raise self._error(f"{heads[0]}# is not a type")
            return self._fitting(literal, ELEMENTARY[heads[0]]) if heads else literal
        if token.kind == "real":
            return _literal(REAL_LITERAL, float(token.text.replace("_", "")))
        if token.kind == "time":
            return _literal(TIME, duration(token.text.partition("#")[2]))
        if token.kind == "string":
            return _literal(ELEMENTARY["STRING"], re.sub(r"\$(.)", r"\1", token.text[1:-1]))
        self._at -= 1
        raise self._error(f"{token.text!r}: expected a value")

    def _path(self, name: str) -> Expression:
        """A variable, a field of it, an element of it."""
        variable = self._unit.variables.get(name)
        if variable is None:
            raise self._error(f"{name} is not declared in {self._unit.name}")
        writable = not variable.constant and variable.section != "VAR_INPUT"
        found = Expression(
            variable.type,
            operator.itemgetter(name),
            (lambda variables: variables, lambda _: name) if writable else None,
        )
        while sign := self._accept(".", "["):
            found = self._field(found) if sign == "." else self._element(found)
        return found

    def _field(self, of: Expression) -> Expression:
        name = self._name()
        fields = of.type.fields if isinstance(of.type, Structure) else {}
        if isinstance(of.type, Unit):
            fields = {
                key: item for key, item in of.type.variables.items() if item.section in {"VAR_INPUT", "VAR_OUTPUT"}
            }
        if name not in fields:
            raise self._error(f"{of.type.name} has no {name}")
        whole = of.value
        place: tuple[Evaluate, Evaluate] = (whole, lambda _: name)
        # Outputs of a block are its own; inputs of this block cannot be written either.
        writable = of.place is not None and not (isinstance(of.type, Unit) and fields[name].section == "VAR_OUTPUT")
        return Expression(fields[name].type, lambda variables: whole(variables)[name], place if writable else None)

    def _element(self, of: Expression) -> Expression:
        index = self._expression()
        self._expect("]")
        if not isinstance(of.type, Array):
            raise self._error(f"{of.type.name} is not an array")
        if index.type is INTEGER_LITERAL:
            index = self._fitting(index, ELEMENTARY["DINT"])
        low, high, whole, line = of.type.low, of.type.high, of.value, self._token.line

        def place(variables: Variables) -> int:
            number = index.value(variables)
            if not low <= number <= high:
                raise StructuredTextError(f"{line}: index {number} is outside {low}..{high}")
            return int(number - low)

        return Expression(
            of.type.element,
            lambda variables: whole(variables)[place(variables)],
            (whole, place) if of.place is not None else None,
        )


def _literal(type_: Elementary, value: Value) -> Expression:
    return Expression(type_, lambda _: value, None, value)


def _fits(kind: Kind, sign: str, level: int) -> bool:
    if level < _LOGIC:
        return kind in {Kind.BOOL, Kind.BITS}
    if level < _COMPARISON:
        return sign in {"=", "<>"} or kind not in {Kind.BOOL, Kind.BITS}
    if kind is Kind.TIME:
        return sign in {"+", "-"}
    return kind in {Kind.SIGNED, Kind.UNSIGNED} or (kind is Kind.REAL and sign != "MOD")


def _nothing(_: Variables) -> None:
    """What CASE without ELSE does with any other value."""


def _copying(value: Evaluate) -> Evaluate:
    return lambda variables: copied(value(variables))


def _raising(error: type[Exception]) -> Execute:
    def execute(_: Variables) -> None:
        raise error

    return execute
