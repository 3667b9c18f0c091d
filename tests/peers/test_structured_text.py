"""The interpreter of Structured Text: values, calls and time, and what it refuses with a line."""

from __future__ import annotations

from typing import Any

import pytest

from pdgw.base.durations import MS
from pdgw.tools.plc.declarations import StructuredTextError
from tests.support.structured_text.compiler import Compiler
from tests.support.structured_text.controller import Controller

FRAMES = "VAR_INPUT received : ARRAY[0..1] OF BYTE; END_VAR VAR_OUTPUT sent : ARRAY[0..1] OF BYTE; END_VAR"


def result(type_: str, expression: str) -> Any:
    """The value of an expression assigned to a variable of a type."""
    text = f"FUNCTION_BLOCK Trial VAR x : {type_}; END_VAR\nx := {expression};\nEND_FUNCTION_BLOCK"
    unit = Compiler(lambda: 0, text).units["TRIAL"]
    values = unit.initial
    unit.body(values)
    return values["X"]


@pytest.mark.parametrize(
    ("type_", "expression", "expected"),
    [
        ("INT", "7 / 2", 3),
        ("INT", "-7 / 2", -3),
        ("INT", "-7 MOD 2", -1),
        ("INT", "INT#32767 + 1", -32768),
        ("UINT", "UINT#0 - 1", 65535),
        ("WORD", "WORD#16#0F0F AND 16#00FF", 0x000F),
        ("WORD", "NOT WORD#16#00FF", 0xFF00),
        ("WORD", "SHL(IN := WORD#16#8001, N := 1)", 2),
        ("BYTE", "WORD_TO_BYTE(SHR(IN := WORD#16#1234, N := 8))", 0x12),
        ("INT", "WORD_TO_INT(16#FFFF)", -1),
        ("DINT", "REAL_TO_DINT(2.5)", 2),
        ("DINT", "REAL_TO_DINT(-3.5)", -4),
        ("REAL", "0.1", 0.10000000149011612),
        ("LREAL", "0.1 * 3.0", 0.30000000000000004),
        ("BOOL", "1 < 2 AND NOT FALSE OR FALSE", True),
        ("INT", "LIMIT(MN := -5, IN := 9, MX := 5)", 5),
        ("INT", "LIMIT(0, 3, 5)", 3),
        ("INT", "SEL(G := TRUE, IN0 := 1, IN1 := 2)", 2),
        ("INT", "ABS(INT#-4)", 4),
        ("INT", "MIN(IN1 := 9, IN2 := ABS(INT#-5))", 5),
        ("TIME", "T#1m2s + T#500ms", 62_500 * MS),
        ("STRING", "'it$'s'", "it's"),
        ("INT", "2 + 3 * 4 - (1 + 1)", 12),
        ("INT", " + ".join(["INT#30000"] * 300), (30000 * 300 + 32768) % 65536 - 32768),
        ("REAL", "x + 16777216.0 + 1.0 + 1.0", 16777216.0),
        ("BOOL", " OR ".join(["TRUE"] * 301), True),
        ("BOOL", "1 = 2 = FALSE", True),
        ("UINT", "UINT#3 - 5 + 1", 65535),
        ("UINT", "(UINT#3 - 5) / 2", 32767),
    ],
)
def test_expressions_have_the_values_of_the_standard(type_: str, expression: str, expected: object) -> None:
    assert result(type_, expression) == expected


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("x := y;", "line 2: Y is not declared in TRIAL"),
        ("x := r;", "line 2: REAL where INT is expected: convert it"),
        ("x := 1.0;", "real literal 1.0 where INT is expected"),
        ("x := 40000;", "integer literal 40000 where INT is expected"),
        ("x := w AND 1;", "WORD where INT"),
        ("b := x;", "INT where BOOL"),
        ("x := x + r;", "REAL where INT"),
        ("b := w < w;", "< does not accept a WORD"),
        ("x := SHL(IN := x, N := 1);", "SHL does not accept a INT"),
        ("i := 5;", "cannot be assigned to"),
        ("x := Unknown(1);", "UNKNOWN: unknown function"),
        ("x := 1; // comment", "'// comment' is not in the supported"),
        ("IF x THEN x := 1; END_IF;", "INT where BOOL"),
        ("t(IN := 1);", "integer literal 1 where BOOL"),
        ("t(OUT := TRUE);", "TON has no parameter OUT"),
        ("x := a;", "ARRAY[0..1] OF INT where INT"),
        ("x := x.y;", "INT has no Y"),
        ("x := 1", "expected ;"),
        ("CASE x OF 1: x := 2; 1: x := 3; END_CASE;", "CASE contains 1 twice"),
        ("x := " + "x * " * 150 + "x;", "the statements or parentheses of TRIAL are nested too deep"),
    ],
)
def test_invalid_program_is_rejected_with_its_line(text: str, said: str) -> None:
    head = (
        "FUNCTION_BLOCK Trial VAR_INPUT i : INT; END_VAR "
        "VAR x : INT; r : REAL; w : WORD; b : BOOL; t : TON; a : ARRAY[0..1] OF INT; END_VAR"
    )
    with pytest.raises(StructuredTextError) as refused:
        Compiler(lambda: 0, f"{head}\n{text}\nEND_FUNCTION_BLOCK")
    assert said in str(refused.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("x := 1 / x;", "line 2: "),
        ("a[x + 5] := 1;", "line 2: index 5 is outside 0..1"),
        ("WHILE TRUE DO x := x + 1; END_WHILE;", "line 2: the loop does not end"),
    ],
)
def test_error_at_run_time_is_reported_with_its_line(text: str, said: str) -> None:
    head = "FUNCTION_BLOCK Trial VAR x : INT; a : ARRAY[0..1] OF INT; END_VAR"
    unit = Compiler(lambda: 0, f"{head}\n{text}\nEND_FUNCTION_BLOCK").units["TRIAL"]
    with pytest.raises(StructuredTextError) as failed:
        unit.body(unit.initial)
    assert str(failed.value).startswith(said)


def test_error_in_a_block_is_reported_with_its_line() -> None:
    inner = "FUNCTION Half : INT VAR_INPUT of : INT; END_VAR\n\nHalf := 100 /\n of;\nEND_FUNCTION"
    outer = "FUNCTION_BLOCK Trial VAR x : INT; END_VAR\nx := Half(0);\nEND_FUNCTION_BLOCK"
    unit = Compiler(lambda: 0, inner, outer).units["TRIAL"]
    with pytest.raises(StructuredTextError, match=r"^line 3: "):
        unit.body(unit.initial)


def test_statements_blocks_and_structures_run() -> None:
    controller = Controller(f"""
TYPE Pair : STRUCT first : INT; second : WORD := 16#00FF; END_STRUCT; END_TYPE
FUNCTION Twice : INT VAR_INPUT value : INT; END_VAR Twice := value * 2; END_FUNCTION
FUNCTION_BLOCK Count
VAR_IN_OUT pair : Pair; END_VAR
VAR_INPUT up : BOOL; END_VAR
VAR_OUTPUT n : INT; END_VAR
    IF up THEN
        n := n + 1;
        pair.first := Twice(n);
    END_IF;
END_FUNCTION_BLOCK
PROGRAM Main
{FRAMES}
VAR counter : Count; pair : Pair; copy : Pair; k : INT; sum : INT; word : WORD; END_VAR
    copy := pair;
    counter(up := TRUE, pair := pair, n => k);
    counter(up := FALSE, pair := pair);
    sum := 0;
    FOR k := 2 TO 4 DO
        sum := sum + k;
    END_FOR;
    WHILE sum < 24 DO
        sum := sum + 5;
    END_WHILE;
    CASE counter.n OF
        1: word := 16#0001;
        2, 3: word := 16#0002; word := word OR 16#0010;
    ELSE
        word := 16#0000;
    END_CASE;
    sent[0] := received[1];
END_PROGRAM
""")
    values = controller.variables
    assert controller.cycle(0, b"ab") == b"b\0"
    assert (values["PAIR"]["FIRST"], values["COPY"]["FIRST"], values["SUM"], values["WORD"]) == (2, 0, 24, 1)
    assert controller.cycle(1, b"wrong size") == b"b\0"
    controller.cycle(2, None)
    assert (values["PAIR"]["FIRST"], values["COPY"]["FIRST"], values["WORD"]) == (6, 4, 0x12)


def test_ton_counts_the_time_of_the_controller() -> None:
    controller = Controller(f"""
PROGRAM Main
{FRAMES}
VAR_OUTPUT finished : BOOL; END_VAR
VAR t : TON; END_VAR
    t(IN := received[0] = 16#01, PT := T#100ms);
    finished := t.Q;
END_PROGRAM
""")
    for now, frame, finished in ((0, b"\1\0", False), (99, None, False), (100, None, True), (101, b"\0\0", False)):
        controller.cycle(now * MS, frame)
        assert controller.finished == finished
        assert controller.outputs() == {"FINISHED": finished}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "the text has 0 PROGRAMs, expected 1"),
        ("PROGRAM Main END_PROGRAM", "MAIN needs RECEIVED : ARRAY OF BYTE in VAR_INPUT"),
        (
            "PROGRAM Main VAR_INPUT received : ARRAY[0..1] OF BYTE; sent : INT; END_VAR END_PROGRAM",
            "MAIN needs SENT : ARRAY OF BYTE in VAR_OUTPUT",
        ),
    ],
)
def test_a_program_has_the_variables_of_the_frames(text: str, said: str) -> None:
    with pytest.raises(StructuredTextError, match=said):
        Controller(text)
