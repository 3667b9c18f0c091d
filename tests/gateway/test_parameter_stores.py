"""Parameter stores of several configurations and processes: each file has its own, and one process writes it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.store import DeviceParameters, ParameterStore, default_store, stored_parameters
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.file import load_config
from pdgw.tools.commands.commissioning.config import check
from tests.support.gateways.daemon import axis, running

TEXT = (
    '[can]\ninterface = "virtual"\nchannel = "world"\n[transport]\ncyclic_port = 0\nacyclic_port = 0\nstatus_port = 0\n'
    f"[trace]\nenabled = false\n{axis(1)}"
)


@pytest.fixture(autouse=True)
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The state directory."""
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path / "state"))
    return tmp_path / "state"


def line(number: int, tmp_path: Path) -> Path:
    """A configuration of the same name in the folder of a line."""
    file = tmp_path / f"line-{number}" / "gateway.toml"
    file.parent.mkdir(exist_ok=True)
    file.write_text(TEXT)
    return file


def select(number: int) -> Callable[[DeviceParameters], None]:
    return lambda parameters: setattr(parameters.drive_object(1), "telegram", number)


def store_of(config: GatewayConfig, reports: list[str]) -> ParameterStore:
    return ParameterStore(config.store, reports.append, config.file)


@pytest.fixture
def earlier(state: Path) -> Path:
    """The store of an earlier version, which files of one name shared; telegram 2 is stored."""
    path = state / "gateway.json"
    state.mkdir()
    ParameterStore(path, pytest.fail).update(select(2))
    return path


def test_two_files_of_one_name_have_two_stores(tmp_path: Path) -> None:
    first, second = (load_config(line(number, tmp_path)) for number in (1, 2))
    assert first.store != second.store
    store_of(first, []).update(select(2))
    reports: list[str] = []
    store_of(second, reports)
    assert reports == [], "the other file has not been moved"
    with running(second) as daemon:
        assert daemon.axes[0].telegram.number == 1
    assert first.store is not None
    assert json.loads(first.store.read_text())["configuration"] == str((tmp_path / "line-1" / "gateway.toml").resolve())
    link = tmp_path / "current.toml"
    link.symlink_to(tmp_path / "line-1" / "gateway.toml")
    assert default_store(link) == first.store, "the same file"


def test_earlier_store_is_copied_by_the_first_file_that_finds_it(tmp_path: Path, earlier: Path) -> None:
    file = line(1, tmp_path)
    config = load_config(file)
    assert stored_parameters(config.store, config.file).telegrams == {1: 2}, "also for who only reads"
    assert not (config.store or file).exists()
    reports: list[str] = []
    assert store_of(config, reports).parameters.telegrams == {1: 2}
    assert reports == [f"parameter store {earlier}: copied to {config.store}, the store of {file.resolve()} alone"]
    store_of(config, reports).update(select(3))
    assert len(reports) == 1
    assert stored_parameters(earlier).telegrams == {1: 2}, "the copy is another file"


def test_second_file_that_finds_an_earlier_store_is_refused(tmp_path: Path, earlier: Path) -> None:
    first, second = line(1, tmp_path), line(2, tmp_path)
    store_of(load_config(first), [])
    config = load_config(second)
    for use in (
        lambda: store_of(config, []),
        lambda: stored_parameters(config.store, config.file),
        lambda: check(second),
    ):
        with pytest.raises(GatewayError) as error:
            use()
        for part in (str(earlier), str(first.resolve()), str(second.resolve()), "set store", "delete"):
            assert part in str(error.value)
    earlier.unlink()
    assert store_of(config, []).parameters.telegrams == {}


def test_own_store_that_was_deleted_does_not_return(tmp_path: Path, earlier: Path) -> None:
    config = load_config(line(1, tmp_path))
    store_of(config, [])
    assert config.store is not None
    config.store.unlink()
    assert store_of(config, []).parameters.telegrams == {}
    assert earlier.exists()


def test_earlier_store_on_a_read_only_disk_is_used(
    tmp_path: Path, earlier: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = load_config(line(1, tmp_path))

    def refuse(*_: object) -> None:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(Path, "replace", refuse)
    reports: list[str] = []
    assert store_of(config, reports).parameters.telegrams == {1: 2}
    assert "cannot be written (Read-only file system)" in reports[0]


def test_moved_file_has_a_line_with_its_older_store(tmp_path: Path) -> None:
    file = line(1, tmp_path)
    before = load_config(file)
    store_of(before, []).update(select(2))
    moved = tmp_path / "line-3" / "gateway.toml"
    file.parent.rename(moved.parent)
    reports: list[str] = []
    assert store_of(load_config(moved), reports).parameters.telegrams == {}
    (report,) = reports
    assert str(before.store) in report
    assert f"is gone; if it is {moved.resolve()} now, set store in it: store = " in report
    moved.write_text(f"store = {json.dumps(str(before.store))}\n{TEXT}")
    assert store_of(load_config(moved), reports).parameters.telegrams == {1: 2}
    assert len(reports) == 1


def test_one_process_writes_a_store(tmp_path: Path) -> None:
    config = load_config(line(1, tmp_path))
    with running(config):
        with pytest.raises(GatewayError, match="another gateway or axis test writes it; end that one, or set store"):
            running(config).__enter__()
        with pytest.raises(GatewayError, match="another gateway"), store_of(config, []).held():
            pass
    with running(config):
        pass
    assert config.store is not None
    assert [item.name for item in config.store.parent.glob("*.new")] == []
