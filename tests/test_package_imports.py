"""Which package may import which: one row for each. ``python -m tests.test_package_imports`` prints the sizes of the packages."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from pdgw.profidrive.signals import SIGNALS
from tests.support.documents.sources import QUOTED, ROOMS, ROOT, statements

PRODUCT = ("profidrive", "profinet", "ds301", "dsp402", "dsp406", "gateway")

_FIELD = "profidrive profinet ds301 dsp402 dsp406"
_PROFINET = "profinet.ethernet profinet.model profinet.station profinet.wire"
"""Modules of ``profinet`` below its sub-packages."""
_DS301 = (
    "ds301.aborts ds301.communication ds301.configuration ds301.counters ds301.emcy ds301.objects ds301.pdo "
    "ds301.sdo_frames ds301.sdo_transfer ds301.values"
)
"""Modules of ``ds301`` below its sub-packages."""
_DSP402 = "dsp402.acting dsp402.drive_type dsp402.modes dsp402.objects dsp402.states"
"""Modules of ``dsp402`` below its sub-packages."""
_CONFIGURED = f"{_FIELD} gateway.base gateway.motion gateway.axis gateway.configuration"
"""Rooms of what works with a configuration."""
_SERVED = f"{_CONFIGURED} gateway.objects gateway.links gateway.service"
"""Rooms of what serves a running gateway."""
_ALL = f"{_FIELD} gateway peers tools"
_COMMAND_LINE = (
    "tools.bus_task tools.command_table tools.options tools.plc_window "
    "tools.commissioning tools.demo tools.output tools.plc tools.service"
)
"""What commands of ``pdgw`` have in common, and what they are made of."""
FOR_ALL = {"base"}
"""The room that every room may import."""
FLOORS = (
    ("base",),
    ("profidrive", "ds301"),
    ("profinet", "dsp402", "dsp406"),
    ("gateway.base",),
    ("gateway.motion", "gateway.axis"),
    (
        "gateway.configuration",
        "gateway.objects",
        "gateway.links",
        "gateway.service",
        "gateway.trace",
        "gateway.parameters",
        "gateway.commissioning",
        "gateway.client",
    ),
    ("gateway.daemon",),
    ("peers", "tools"),
)
"""The rooms from the ground up. A room imports only from floors before its own, and from rooms before it on its own."""
ROWS = {
    "base": "",
    "profidrive": "",
    "profidrive.parameters": "profidrive",
    "profinet": "profidrive",
    "profinet.rpc": "profinet.wire profidrive",
    "profinet.blocks": "profinet.rpc profinet.wire profidrive",
    "profinet.alarms": f"profinet.blocks {_PROFINET} profidrive",
    "profinet.connection": f"profinet.alarms profinet.blocks profinet.rpc {_PROFINET} profidrive",
    "profinet.discovery": f"{_PROFINET} profidrive",
    "profinet.records": "profinet.connection profinet.discovery profinet.alarms profinet.blocks profinet.rpc "
    f"{_PROFINET} profidrive",
    "ds301": "",
    "ds301.loop": "ds301.counters",
    "ds301.bus": f"{_DS301} ds301.loop",
    "ds301.eds": _DS301,
    "ds301.node": f"{_DS301} ds301.loop ds301.bus",
    "dsp402": "ds301",
    "dsp402.units": f"ds301 {_DSP402}",
    "dsp402.pdo": f"ds301 {_DSP402}",
    "dsp402.identification": f"ds301 {_DSP402} dsp402.units dsp402.pdo",
    "dsp402.drive": f"ds301 {_DSP402} dsp402.units dsp402.pdo dsp402.identification",
    "dsp406": "ds301",
    "gateway": "",
    "gateway.base": "ds301 dsp402",
    "gateway.motion": "profidrive gateway.base",
    "gateway.axis": "profidrive ds301 dsp402 gateway.motion gateway.base",
    "gateway.axis.adapters": "profidrive gateway.axis gateway.motion gateway.base",
    "gateway.axis.executors": "profidrive ds301 dsp402 dsp406 gateway.axis gateway.motion gateway.base",
    "gateway.axis.executors.positions": "profidrive ds301 dsp402 gateway.axis gateway.axis.executors gateway.motion "
    "gateway.base",
    "gateway.axis.supervision": "profidrive ds301 dsp402 gateway.axis gateway.base",
    "gateway.configuration": f"{_FIELD} gateway.base gateway.motion gateway.axis",
    "gateway.objects": _CONFIGURED,
    "gateway.links": f"{_CONFIGURED} gateway.objects",
    "gateway.links.profinet": f"{_CONFIGURED} gateway.objects gateway.links",
    "gateway.service": f"{_CONFIGURED} gateway.objects gateway.links",
    "gateway.trace": _SERVED,
    "gateway.parameters": _SERVED,
    "gateway.commissioning": _CONFIGURED,
    "gateway.client": _CONFIGURED,
    "gateway.daemon": f"{_SERVED} gateway.trace gateway.parameters",
    "tools.decoder": f"{_FIELD} tools.decoder.frames gateway",
    "tools.decoder.frames": f"{_FIELD} gateway",
    "tools.decoder.frames.canopen": f"{_FIELD} tools.decoder.frames gateway",
    "tools.decoder.frames.profinet": f"{_FIELD} tools.decoder.frames gateway",
    "tools.decoder.view": f"{_FIELD} tools.decoder.frames gateway",
    "tools.decoder.capture": f"{_FIELD} tools.decoder.frames tools.decoder.view gateway",
    "tools.decoder.timeline": f"{_FIELD} tools.decoder.frames gateway",
    "tools.decoder.export": f"{_FIELD} tools.decoder.frames "
    "tools.decoder.view tools.decoder.capture tools.decoder.timeline gateway",
    "tools.web": f"{_FIELD} gateway tools.decoder gateway.client",
    "tools.web.status": "ds301 gateway",
    "tools.web.server": "gateway tools.web.stream",
    "tools.recording": f"{_FIELD} gateway tools.decoder",
    "peers": "",
    "peers.node": "ds301 peers.habits",
    "peers.drive": "ds301 dsp402 peers.node peers.option_values",
    "peers.drive.model": "ds301 dsp402 peers.drive.objects peers.drive.option_codes peers.option_values",
    "peers.encoder": "ds301 dsp406 peers.habits peers.node peers.option_values",
    "peers.bus": "ds301 gateway.base peers.node",
    "peers.plc.exchange": f"{_FIELD} gateway",
    "peers.plc": f"{_FIELD} gateway peers.plc.exchange",
    "peers.controller": f"{_FIELD} gateway peers.plc",
    "peers.simulation": f"{_FIELD} gateway peers.bus peers.drive peers.encoder peers.node peers.option_values",
    "peers.world": f"{_FIELD} gateway peers.plc peers.plc.exchange peers.drive peers.encoder peers.simulation",
    "tools": _ALL,
    "tools.commands": "",
    "tools.commands.capture": f"{_FIELD} gateway tools.decoder tools.recording peers {_COMMAND_LINE}",
    "tools.commands.commissioning": f"{_FIELD} gateway peers {_COMMAND_LINE}",
    "tools.commands.gateway": f"{_FIELD} gateway tools.decoder gateway.client tools.recording tools.web peers "
    f"tools.commands.simulation {_COMMAND_LINE}",
    "tools.commands.simulation": f"{_FIELD} gateway peers {_COMMAND_LINE}",
    "tools.commissioning": f"{_FIELD} gateway peers tools.bus_task",
    "tools.demo": f"{_FIELD} gateway tools.decoder tools.recording peers",
    "tools.output": f"{_FIELD} gateway tools.decoder.capture",
    "tools.plc": f"{_FIELD} gateway",
    "tools.service": f"{_FIELD} gateway tools.decoder tools.recording peers",
}
"""What each package may import beside itself and its sub-packages: other packages with theirs, or single modules."""

_TEXT = re.compile(rf"#.*|(?:\b[rRbBuUfF]{{1,2}})?(?:{QUOTED})")
"""Comments, and strings with their prefixes. The tokenizer of the library needs five times as long."""
_CODE = re.compile(r"\d[\w.]*(?:(?<=\de)[+-]\d+)?|\w+|\*\*=?|//=?|>>=?|<<=?|->|:=|\.{3}|[-+*/%@&|^=<>!]=|[^\w\s\\]")
"""Names, numbers and operators."""


@cache
def imports(file: Path) -> frozenset[str]:
    """Every module a file imports, wherever in it."""
    return frozenset(_imports(file))


def _imports(file: Path) -> Iterator[str]:
    for node in statements(file):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            folder = ROOT.joinpath(*node.module.removeprefix("pdgw").strip(".").split("."))
            for alias in node.names:
                module = (folder / f"{alias.name}.py").exists() or (folder / alias.name / "__init__.py").exists()
                yield f"{node.module}.{alias.name}" if module else node.module


def test_every_package_has_its_row() -> None:
    found = {file.parent.relative_to(ROOT) for room in ROOMS for file in (ROOT / room).rglob("__init__.py")}
    assert set(ROWS) == {".".join(folder.parts) for folder in found} - {"pdgw"}


def code_tokens(file: Path) -> int:
    """Names, operators and numbers. Comments, docstrings and line breaks cost nothing, and a string is no code."""
    return len(_CODE.findall(_TEXT.sub(" ", file.read_text(encoding="utf-8"))))


def room_of(package: str) -> str:
    """The folder of the top level that has it; of the gateway's, each sub-package is a room."""
    room, _, below = package.partition(".")
    return f"gateway.{below.partition('.')[0]}" if room == "gateway" and below else room


def sizes() -> dict[str, int]:
    """Code tokens of each room, ``gateway`` without its sub-packages; lines of C, JavaScript and TOML."""
    long = set((ROOT / "tests/long").rglob("*.py"))
    tests = set((ROOT / "tests").rglob("*.py")) - long
    files: dict[str, list[Path]] = {}
    for package in ("pdgw", *ROWS):
        files.setdefault(room_of(package), []).extend((ROOT / package.replace(".", "/")).glob("*.py"))
    beside = [
        ROOT / "setup.py",
        *(file for room in ("deploy", "docs") for file in (ROOT / room).rglob("*.py")),
    ]
    made = {
        name: sum(map(code_tokens, found))
        for name, found in {**files, "beside": beside, "tests/long": long, "tests": tests}.items()
    }
    for suffix in ("c", "js", "toml"):
        files_of = (file for room in ROOMS for file in (ROOT / room).rglob(f"*.{suffix}") if "vendor" not in file.parts)
        made[f"*.{suffix}"] = sum(len(file.read_text(encoding="utf-8").splitlines()) for file in files_of)
    return made


def test_comments_strings_and_line_breaks_cost_no_tokens(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text('"""Text."""\nx = f(\n    1,\n)  # why\ny = f"{x + 1}"\n')
    assert code_tokens(tmp_path / "a.py") == len(["x", "=", "f", "(", "1", ",", ")", "y", "="])


def test_packages_import_only_what_their_rows_allow() -> None:
    known = {".".join(path.parts) for path in _modules()}
    found = set()
    for package, row in ROWS.items():
        allowed = {package, *row.split(), *FOR_ALL}
        assert allowed - FOR_ALL <= known, "a row names what does not exist"
        found |= {
            (package, file.name, name)
            for file in (ROOT / package.replace(".", "/")).glob("*.py")
            for name in imports(file)
            if name.startswith("pdgw.") and not _within(name.removeprefix("pdgw."), allowed)
        }
    assert found == set()


def test_modules_form_no_import_circle() -> None:
    """Not even for types, or inside a function."""
    graph = {"pdgw": {name.removeprefix("pdgw.") for name in imports(ROOT / "pdgw/__init__.py")}}
    for package in ROWS:
        for file in (ROOT / package.replace(".", "/")).glob("*.py"):
            module = package if file.stem == "__init__" else f"{package}.{file.stem}"
            graph[module] = {name.removeprefix("pdgw.") for name in imports(file)} - {module}
    assert set(graph) <= set(TopologicalSorter(graph).static_order())


def test_every_room_imports_only_from_rooms_below_it() -> None:
    rooms = [room for floor in FLOORS for room in floor]
    for package, row in ROWS.items():
        below = {*rooms[: rooms.index(room_of(package))], room_of(package)} if room_of(package) in rooms else set()
        found = {room_of(item) for item in row.split()} - {"gateway"}
        assert found <= below, f"{package} imports from above: {found - below}"


def test_allowed_imports_form_no_cycle() -> None:
    """Only a package with its own sub-packages may have one."""
    graph = {
        package: {
            other for item in row.split() if not _within(package, {item}) for other in ROWS if _within(other, {item})
        }
        for package, row in ROWS.items()
    }
    assert set(TopologicalSorter(graph).static_order()) == set(ROWS)


def _modules() -> Iterator[Path]:
    """Each module and package by its path without suffix."""
    for package in ROWS:
        folder = Path(package.replace(".", "/"))
        yield folder
        yield from (folder / file.stem for file in (ROOT / folder).glob("*.py"))


def _within(name: str, allowed: set[str]) -> bool:
    return any(f"{name}.".startswith(f"{other}.") for other in allowed)


def test_gateway_decoder_and_peers_use_no_library_of_the_page() -> None:
    for room in (*PRODUCT, "tools/decoder", "tools/recording", "peers"):
        names = {name.partition(".")[0] for file in (ROOT / room).rglob("*.py") for name in imports(file)}
        assert not names & {"starlette", "uvicorn", "prometheus_client", "paho"}, room


@pytest.mark.parametrize("name", ["rules", "walk/monitor"])
def test_safety_rules_import_neither_power_table_nor_interlock(name: str) -> None:
    known = imports(ROOT / "tests" / "long" / f"{name}.py")
    assert not [name for name in known if name.endswith(("power_table", "power_cells", "interlock"))]


def test_test_support_imports_no_tests() -> None:
    shared = {name for file in (ROOT / "tests" / "support").rglob("*.py") for name in imports(file)}
    of_tests = {
        name for name in shared if name.startswith("tests.") and not name.startswith(("tests.support", "tests.long"))
    }
    assert of_tests <= {"tests.conftest"}


@pytest.mark.parametrize("room", ["ds301", "dsp402", "dsp406"])
def test_canopen_packages_have_no_profidrive_terms(room: str) -> None:
    """Signals without a number are telegram 100's, which have the names of objects."""
    words = {name for name, signal in SIGNALS.items() if signal.number} | {"N2", "N4", "PNU", "NSOLL", "NIST", "DO-ID"}
    found = {
        (str(file.relative_to(ROOT)), word)
        for file in (ROOT / room).rglob("*.py")
        for word in re.findall(r"[A-Z][A-Z0-9_-]+", file.read_text(encoding="utf-8"))
        if word in words
    }
    assert found == set()


def test_search_finds_existing_imports() -> None:
    assert "pdgw.peers.simulation.console" in imports(ROOT / "tools" / "commands" / "simulation" / "devices.py")


def test_pydantic_errors_are_worded_in_one_place() -> None:
    """Code that catches a ValidationError passes it to ``pdgw.base.validation``; only ``error_count`` needs no text."""
    catching = [
        file
        for room in (*PRODUCT, "peers", "tools")
        for file in (ROOT / room).rglob("*.py")
        if "except ValidationError" in file.read_text(encoding="utf-8")
    ]
    assert len(catching) > 5
    for file in catching:
        text = file.read_text(encoding="utf-8")
        assert "pdgw.base.validation" in imports(file), file
        assert ".errors()" not in text, file


def test_units_of_time_are_declared_once() -> None:
    """No module contains the nanoseconds of a millisecond or a second as a number."""
    spelled_out = re.compile(r"[*/%] (1e[69]|1_000_000|1_000_000_000|10\*\*[69])\b")
    found = [
        (str(file.relative_to(ROOT)), line.strip())
        for room in (*PRODUCT, "peers", "tools")
        for file in (ROOT / room).rglob("*.py")
        for line in file.read_text(encoding="utf-8").splitlines()
        if spelled_out.search(line)
    ]
    assert found == []


if __name__ == "__main__":
    for name, size in sizes().items():
        print(f"{size:8} {name}")
