"""Damaged recordings: replay, timeline and reader show what is before the damage, then one error with its place."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from random import Random

import pytest
import typer

from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.trace import pcapng
from pdgw.gateway.trace.reader import RingReader
from pdgw.tools.commands.capture.timeline import replay, timeline
from pdgw.tools.decoder.step_replay import ReplayError
from pdgw.tools.recording.recordings import replayed
from tests.support.gateways.daemon import OFF, axis, configuration, drive_of
from tests.support.gateways.recorded_daemon import recorded, recording


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A recording with a telegram, a fault and events."""
    folder = tmp_path_factory.mktemp("whole")
    with recorded(configuration(axis(1)), folder) as plc:
        plc.enable()
        drive_of(plc.daemon).inject(7)
        plc.exchange(100)
        plc.endpoint.set(0, {"STW1": OFF})
        plc.exchange(100)
    return Path(recording(folder)).read_bytes()


def ring(file: Path) -> None:
    reader = RingReader(file)
    reader.cycles()


READERS: dict[str, Callable[[Path], object]] = {
    "replay": lambda file: replay([file]),
    "timeline": lambda file: timeline([str(file)]),
    "ring": ring,
}


@pytest.mark.parametrize("name", READERS)
def test_damaged_recording_is_one_error(
    name: str, whole: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "gateway.pcapng"
    refused = 0
    for seed in range(60):
        random, data = Random(seed), bytearray(whole)
        for _ in range(random.choice([1, 3, 20])):
            at = random.choice([random.randrange(len(data)), random.randrange(9000)])
            data[at : at + random.choice([0, 1, 4])] = random.randbytes(random.choice([0, 1, 4]))
        file.write_bytes(data)
        with suppress(typer.Exit):  # a difference
            try:
                READERS[name](file)
            except GatewayError:
                refused += 1
    assert refused > 10
    capsys.readouterr()


def middle_cycle(data: bytes) -> int:
    """The place of events in the middle of a recording."""
    cycles = [at for kind, at, _ in pcapng.walk(data) if kind == pcapng.CUSTOM and pcapng.cycle_at(data, at)]
    return data.index(b'{"', cycles[len(cycles) // 2])


def test_what_is_before_the_damage_is_shown(whole: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    at = middle_cycle(whole)
    block = next(begin for _, begin, length in pcapng.walk(whole) if begin <= at < begin + length)
    file = tmp_path / "gateway.pcapng"
    file.write_bytes(whole[:at] + b"?" + whole[at + 1 :])
    place = f"{file}: offset {block}: damaged"
    with pytest.raises(ReplayError) as found:
        replayed([str(file)])
    assert str(found.value).startswith(place)
    (outcome,) = found.value.outcomes
    assert outcome.steps > 50
    with pytest.raises(GatewayError, match="damaged"):
        replay([file])
    assert f"{outcome.steps} steps compared" in capsys.readouterr().out
    with pytest.raises(GatewayError) as error:
        timeline([str(file)])
    assert str(error.value).startswith(place)
    assert "047Eh -> 047Fh +ON" in capsys.readouterr().out


@pytest.mark.parametrize("name", READERS)
def test_cycle_before_its_description_is_damage(name: str, whole: bytes, tmp_path: Path) -> None:
    at = whole.index(pcapng.DESCRIPTION + bytes(3), 24)
    file = tmp_path / "gateway.pcapng"
    file.write_bytes(whole[:at] + b"?" + whole[at + 1 :])
    with pytest.raises(GatewayError, match=r"a cycle before the description|not a recording of the gateway"):
        READERS[name](file)


def test_cut_recording_is_replayed_to_its_end(whole: bytes, tmp_path: Path) -> None:
    blocks = list(pcapng.walk(whole))
    _, begin, length = blocks[len(blocks) // 2]
    file = tmp_path / "gateway.pcapng"
    file.write_bytes(whole[: begin + length - 2])
    with pytest.raises(ReplayError, match=f"offset {begin}: the file ends within a block") as found:
        replayed([str(file)])
    assert found.value.outcomes[0].steps > 50


@pytest.mark.parametrize("page", [False, True])
def test_timeline_shows_a_cut_recording_to_its_end(
    whole: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str], *, page: bool
) -> None:
    blocks = list(pcapng.walk(whole))
    _, begin, length = blocks[len(blocks) * 3 // 4]
    file = tmp_path / "gateway.pcapng"
    file.write_bytes(whole[: begin + length - 2])
    html = tmp_path / "timeline.html" if page else None
    with pytest.raises(GatewayError, match=f"^{file}: offset {begin}: "):
        timeline([str(file)], html=html)
    text = capsys.readouterr().out if html is None else html.read_text()
    assert "047Eh -> 047Fh +ON" in text


def test_compressed_recording_is_replayed_to_its_damage(
    whole: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plain, packed = tmp_path / "plain.pcapng", tmp_path / "packed.pcapng.gz"
    plain.write_bytes(whole)
    packed.write_bytes(data := gzip.compress(whole))
    assert replayed([str(packed)]) == replayed([str(plain)])
    timeline([str(plain)])
    expected = capsys.readouterr().out
    timeline([str(packed)])
    assert capsys.readouterr().out == expected
    packed.write_bytes(data[: len(data) // 2])
    with pytest.raises(ReplayError, match=r"offset \d+: the compressed data is damaged or ends early") as found:
        replayed([str(packed)])
    assert found.value.outcomes[0].steps > 50


def test_unknown_code_of_a_reason_has_its_number() -> None:
    description = pcapng.Description("", "", 0, 0, True, None, (), (), ("NO_CONTROL",))  # type: ignore[arg-type]
    assert [description.reason(code) for code in (0, 1, 2, -1)] == ["", "NO_CONTROL", "reason 2", "reason -1"]
