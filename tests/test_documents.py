"""The documents: every command in them exists with its options, every file they name is there.

``make tour`` runs the commands of the tutorials, README and ``tests/tour/other-documents.md``, each in processes of its own.
Others run here, in this process, on files made for them.
"""

from __future__ import annotations

import re
import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from pdgw.base.durations import MS
from pdgw.tools.cli import app
from tests.decoder.frames.profinet.test_profinet import frames as profinet_frames
from tests.support.axis.recorded import speed
from tests.support.axis.rig import NODE
from tests.support.cli import pdgw
from tests.support.documents import deviations
from tests.support.documents.parts import read_part
from tests.support.documents.sources import ROOMS
from tests.support.gateways.daemon import axis, configuration
from tests.support.gateways.recorded_daemon import recorded, recording
from tests.support.readers import captures

ROOT = Path(__file__).parents[1]
DOCUMENTS = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
INLINE = re.compile(r"`(pdgw [^`]+)`")
BLOCK = re.compile(r"^(?: {4,}| *\$ )(pdgw .+)$", re.MULTILINE)
_LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")
_ANCHOR = re.compile(r"\]\(([^)#\s:]*\.md)?#([^)\s]+)\)")
_WORD = re.compile(r"[a-z][a-z-]*")


def commands(text: str) -> Iterator[str]:
    """The commands without comments; a command may continue in the next line of prose."""
    for pattern in (INLINE, BLOCK):
        for match in pattern.finditer(text):
            yield " ".join(re.split(r"  #| # | > | &(?:$| )", match[1])[0].split())


APP: Any = get_command(app)


def resolve(words: list[str]) -> tuple[Any, list[str]]:
    """The command of the first words, and the remaining words."""
    command = APP
    context = command.make_context("pdgw", [], resilient_parsing=True)
    while hasattr(command, "commands") and words:
        if words[0] in {option for item in command.params if getattr(item, "is_flag", False) for option in item.opts}:
            words = words[1:]  # a switch of the group, before its command
            continue
        if not _WORD.fullmatch(words[0]):
            break
        name, command, rest = command.resolve_command(context, words)
        assert command is not None, name
        context = command.make_context(name, [], parent=context, resilient_parsing=True)
        words = list(rest)
    return command, words


ALL = sorted({(path.name, command) for path in DOCUMENTS for command in commands(path.read_text())})


@pytest.mark.parametrize(("document", "text"), ALL)
def test_every_command_exists_with_its_options(document: str, text: str) -> None:
    rest_of_line = text.removeprefix("pdgw").replace("...", "").replace("|", " ")
    words = [word.strip(",;.") for word in shlex.split(rest_of_line)]
    if words and not _WORD.fullmatch(words[0]) and not words[0].startswith("-"):
        pytest.skip("a placeholder")
    command, rest = resolve(words)
    known = {option for parameter in command.params for option in (*parameter.opts, *parameter.secondary_opts)}
    known |= {"-h", "--help"}
    for word in rest:
        if re.match(r"--?[a-z]", word):
            assert word.partition("=")[0] in known, f"{document}: {text}: {word}"


@pytest.mark.parametrize("path", DOCUMENTS[1:], ids=lambda path: path.name)
def test_every_document_says_first_who_reads_it_when(path: Path) -> None:
    """A tutorial in its title."""
    title, _, first, *_ = path.read_text("utf-8").splitlines()
    assert (title.removeprefix("# ") if path.parent.name == "tutorials" else first).startswith("For ")


def test_first_drawing_of_the_readme_fits_into_the_column_of_the_site() -> None:
    """The site has 80 characters of code beside its two navigations in a window of 1300 pixels."""
    drawing = re.findall(r"^ {4}(.*)$", (ROOT / "README.md").read_text("utf-8").partition("\n* ")[0], re.MULTILINE)
    assert len(drawing) == 4
    assert max(map(len, drawing)) <= 80


def test_site_has_every_document_and_every_package_in_its_navigation() -> None:
    navigation = set(re.findall(r"^ +- (\S+\.md)$", (ROOT / "mkdocs.yml").read_text("utf-8"), re.MULTILINE))
    documents = {path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs").rglob("*.md")}
    assert documents | {f"api/{room}.md" for room in ROOMS if room != "pdgw"} <= navigation


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_every_link_leads_to_a_file(path: Path) -> None:
    for target in _LINK.findall(path.read_text()):
        if "://" not in target:
            assert (path.parent / target).exists(), target


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_every_link_into_a_document_leads_to_a_heading(path: Path) -> None:
    for target, anchor in _ANCHOR.findall(path.read_text()):
        text = (path.parent / target if target else path).read_text()
        slugs = {
            re.sub(r"[^\w -]", "", title.lower()).strip().replace(" ", "-")
            for title in re.findall(r"^#+ (.*)$", text, re.MULTILINE)
        }
        assert anchor in slugs, f"{target}#{anchor}"


def test_files_named_in_architecture_exist() -> None:
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (.*) \| (`.*`) \|$", text.partition("## Where is")[2].partition("\n## ")[0], re.MULTILINE)
    assert len(rows) >= 20
    files = [file for _, named in rows for file in re.findall(r"`([^`]+)`", named)]
    assert [file for file in files if not (ROOT / file).is_file()] == []


_ALIKE = re.compile(r"\bpress\.toml\b")

HERE = {
    "pdgw --version": "pdgw ",
    "pdgw config check gateway.toml": "gateway.toml: ok, 1 axis",
    "pdgw config example": "[[axis]]",
    'pdgw decode plant.pcap --filter \'kind == "alarm" or kind == "dcp"\'': "",
    "pdgw timeline plant.pcap --station press-1 --html plant.html": "",
    "pdgw decode plc.pcap --filter 'stw1.on == 0 and axis == 1'": "STW1 047Eh",
    "pdgw drives": "epos4",
    "pdgw drives my.eds": "engel",
    "pdgw drives epos4": "EPOS4",
    "pdgw map gateway.toml": "NSOLL_A",
    "pdgw map gateway.toml --format codesys --out pdgw.xml": "",
    "pdgw map gateway.toml --format csv --out map.csv": "",
    "pdgw map gateway.toml --format plcopen --out pdgw.xml": "",
    "pdgw map gateway.toml --format scl --out pdgw.scl": "",
    "pdgw map gateway.toml --format st --out pdgw.st": "",
    "pdgw map gateway.toml --format udt --out pdgw.udt": "",
    "pdgw replay recording/gateway.pcapng": "all equal",
    "pdgw sim bus --example": "[[device]]",
    "pdgw timeline plc.pcap can.log": "anomalies: none",
    "pdgw timeline plc.pcap can.log --config gateway.toml": "anomalies: none",
}
"""Commands typed here, with something of what they print."""

PROFINET = {
    "pdgw map gateway.toml --format scl --out pdgw.scl --gsdml .": "GSDML-V2.4-pdgw-profidrive-gateway-",
    "pdgw map gateway.toml --gsdml .": "GSDML-V2.4-pdgw-profidrive-gateway-",
}
"""As ``HERE``, with ``type = "profinet"`` in the configuration."""


def test_the_commands_typed_here_are_in_the_documents() -> None:
    found = {_ALIKE.sub("gateway.toml", text) for path in DOCUMENTS for text in commands(path.read_text("utf-8"))}
    assert HERE.keys() | PROFINET.keys() <= found


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files with the names the documents use."""
    made = tmp_path_factory.mktemp("documents")
    speed().frames.write(made)
    with recorded(configuration(axis(1)), made) as plc:
        plc.enable()
    (made / "recording").mkdir()
    Path(recording(made)).rename(made / "recording" / "gateway.pcapng")
    packets = [(captures.BEGIN_NS + i * MS, captures.ETHERNET, data) for i, data in enumerate(profinet_frames())]
    (made / "plant.pcap").write_bytes(captures.pcap(packets))
    shutil.copy(ROOT / "dsp402" / "eds" / "engel.eds", made / "my.eds")
    return made


def configure(folder: Path, transport: str) -> None:
    (folder / "gateway.toml").write_text(
        f'[can]\ninterface = "virtual"\n[transport]\ncycle_time_ms = 4\n{transport}\n'
        f"[[axis]]\ndo_id = 1\nnode_id = {NODE}\ntelegram = 1\n"
    )


@pytest.mark.parametrize("command", sorted(HERE.keys() | PROFINET.keys()))
def test_document_command_gives_the_documented_output(
    command: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    configure(folder, 'type = "profinet"\ninterface = "eth1"' if command in PROFINET else "")
    words = shlex.split(command.replace("press-1", "gateway"))[1:]  # the station in the capture
    done = pdgw(*words)
    assert done.returncode == 0, done.stderr
    assert ({**HERE, **PROFINET})[command] in done.stdout + done.stderr
    for option in ("--out", "--html"):
        if option in words:
            assert (folder / words[words.index(option) + 1]).stat().st_size


def test_table_of_deviations_is_that_of_the_list() -> None:
    assert read_part(*deviations.PLACE) == deviations.deviation_table()


@pytest.mark.parametrize("item", deviations.DEVIATIONS, ids=lambda item: item.printed[:20])
def test_deviation_names_the_test_that_shows_it(item: deviations.Deviation) -> None:
    file, _, name = item.check.partition("::")
    assert f"def {name}(" in (ROOT / file).read_text(encoding="utf-8")
    assert item.why
