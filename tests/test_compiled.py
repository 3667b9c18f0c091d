"""What the compiled build compiles: the modules of the cyclic path, and none that mypyc cannot take.

The tests of these modules run on whichever build is installed (`make test COMPILED=1` runs all on the compiled one).
"""

from __future__ import annotations

import ast
import re
import sys
from pathlib import Path

import pytest

from tests.long.release import modules
from tests.support.documents.sources import ROOMS

ROOT = Path(__file__).parents[1]
OTHER_LIBRARIES = {"can", "canopen", "greenlet", "scapy", "pydantic", "typer", "rich"}


MODULES = modules()


C_KEYWORDS = {"_asm", "_const", "_inline", "_signed", "_volatile"}
"""Attributes that a compiled class cannot have."""


@pytest.mark.parametrize("name", MODULES)
def test_compiled_modules_exist_and_avoid_known_pitfalls(name: str) -> None:
    tree = ast.parse((ROOT / name).read_text(encoding="utf-8"))
    of_libraries = {
        (alias.asname or alias.name).partition(".")[0]
        for item in ast.walk(tree)
        if isinstance(item, ast.Import | ast.ImportFrom)
        for alias in item.names
        if (getattr(item, "module", None) or alias.name).partition(".")[0] in OTHER_LIBRARIES
    }
    for item in ast.walk(tree):
        if isinstance(item, ast.Attribute):
            assert item.attr not in C_KEYWORDS, (
                f"{item.attr}: mypyc writes another _ before it, and that is a keyword of C"
            )
        if isinstance(item, ast.AnnAssign) and isinstance(item.value, ast.Tuple):
            floats = [isinstance(part, ast.Constant) and isinstance(part.value, float) for part in item.value.elts]
            assert not (floats and all(floats)), (
                f"{ast.unparse(item.target)}: mypyc takes a constant tuple of floats for one that is not set"
            )
        if isinstance(item, ast.FunctionDef):
            calls = [
                part for part in ast.walk(item) if isinstance(part, ast.Call) and "addressof" in ast.unparse(part.func)
            ]
            kept = {argument.arg for argument in item.args.args}
            assert {ast.unparse(call.args[0]) for call in calls} <= kept, (
                f"{item.name}: a compiled function releases a local variable after its last use; the caller keeps an argument"
            )
        if isinstance(item, ast.ClassDef):
            derived = {ast.unparse(base).partition(".")[0] for base in item.bases} & of_libraries
            assert not derived, f"{item.name}: a class of an interpreted library cannot be a compiled one's base"
        if isinstance(item, ast.ClassDef) and "dataclass" in "".join(map(ast.unparse, item.decorator_list)):
            of_class = [part for part in item.body if isinstance(part, ast.AnnAssign)]
            assert not any("ClassVar" in ast.unparse(part.annotation) for part in of_class), (
                f"{item.name}: a compiled dataclass takes a ClassVar for a field; a base class may have it"
            )
        if isinstance(item, ast.ClassDef) and any("enum" in ast.unparse(base).lower() for base in item.bases):
            methods = {method.name for method in item.body if isinstance(method, ast.FunctionDef)}
            assert "__init__" not in methods, f"{item.name}: an enum with an __init__ does not compile"


_IMPORT = re.compile(r"^ *from ([\w.]+) import (?:\(([^)]*)\)|(.+))$", re.MULTILINE)
_CLASS = re.compile(r"^ *class (\w+)\(([^:]*)\):", re.MULTILINE)


def test_no_interpreted_class_derives_from_a_compiled_one() -> None:
    compiled = {f"pdgw.{name.removesuffix('.py').replace('/', '.')}" for name in MODULES}
    derived = []
    for path in (path for room in (*ROOMS, "tests") for path in (ROOT / room).rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        names = " ".join(several or one for module, several, one in _IMPORT.findall(text) if module in compiled)
        if names and str(path.relative_to(ROOT)) not in MODULES:
            words = set(re.findall(r"\w+", names))
            derived += [(path, name) for name, bases in _CLASS.findall(text) if words & set(re.findall(r"\w+", bases))]
    assert derived == []


def test_the_build_under_test_is_the_one_asked_for() -> None:
    from pdgw.gateway.base.identity import kind  # noqa: PLC0415

    asked = any("compiled" in Path(entry).parts for entry in sys.path)
    assert kind() == ("compiled" if asked else "pure Python")
