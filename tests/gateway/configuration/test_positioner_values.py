"""The positioner's parameters P2571 to P2623: over the parameter channel, in the store, in the axis."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from pdgw.client.udp import ParameterClient
from pdgw.gateway.axis.executors.positions.positioner import PositionerExecutor
from pdgw.gateway.configuration.positioner_values import BLOCK_ITEMS, ITEMS, LIMIT_KEYS, PositionerValues, row_of
from pdgw.gateway.configuration.tables.defaults import SIMULATED_KEYS
from pdgw.gateway.configuration.tables.positioner import BlockConfig, PositionerConfig
from pdgw.gateway.daemon import Daemon
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.motion.blocks import Block, BlockMode, BlockNext, BlockTask
from pdgw.gateway.motion.requests import PositionerChoices
from pdgw.gateway.objects.axis import Axis
from pdgw.gateway.store import DeviceParameters
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.parameters.codec import ParameterAddress, Values
from pdgw.profidrive.parameters.errors import ParameterErrorNumber as Number
from tests.support.gateways.daemon import SIMULATED_POSITIONER, Plc, axis, configuration, exchanging, serving

CONFIG = configuration(axis(1, telegram_number=111, more=SIMULATED_POSITIONER))
BLOCKS = (
    Block(0, -5, 300),
    Block(1, 7, 6000, 50, 25, BlockMode.RELATIVE, next=BlockNext.FLYING),
    Block(2, 0, 10, mode=BlockMode.ENDLESS_NEGATIVE, next=BlockNext.EXTERNAL),
    Block(3, task=BlockTask.WAIT, value=500, next=BlockNext.CONTINUE_WITH_STOP),
    Block(4, task=BlockTask.GOTO, value=1),
    Block(5, 900, 10, task=BlockTask.FIXED_STOP, value=250),
    Block(6, task=BlockTask.SET_OUTPUT, value=3),
    Block(7, task=BlockTask.RESET_OUTPUT, value=1),
    Block(127, 1, 1, mode=BlockMode.ENDLESS_POSITIVE),
)


def choices(daemon: Daemon) -> PositionerChoices:
    executor = daemon.axes[0].machine.executor
    assert isinstance(executor, PositionerExecutor)
    return executor.choices


def read(client: ParameterClient, pnu: int, subindex: int = 0, elements: int = 0) -> int:
    (answer,) = client.request([ParameterAddress(pnu, subindex, elements)])
    assert not answer.failed, answer.text
    return int(answer.values[0])


def write(client: ParameterClient, pnu: int, value: int, block: int | None = None) -> Values:
    spec = (ITEMS | BLOCK_ITEMS)[pnu].spec
    address = ParameterAddress(pnu, 0, 0) if block is None else ParameterAddress(pnu, block, 1)
    (answer,) = client.request([address], [Values(spec.type, (value,))])
    return answer


def error(answer: Values) -> int:
    assert answer.failed
    return int(answer.values[0])


@pytest.mark.parametrize("pnu", [pnu for pnu in ITEMS if ITEMS[pnu].spec.high != 1])
def test_each_parameter_is_the_key_of_its_name(pnu: int) -> None:
    config = PositionerConfig.model_validate(SIMULATED_KEYS)
    item, value = ITEMS[pnu], 1234
    values = PositionerValues(config, (), {pnu: value}, {})
    assert PositionerValues(config, (), {}, {}).value(pnu) != value
    assert values.value(pnu) == value
    taken = values.choices()
    if item.key in LIMIT_KEYS:
        assert taken.software_limits is not None
        assert taken.software_limits[LIMIT_KEYS.index(item.key)] == value
    else:
        changed = config.model_copy(update={item.key: value})
        assert taken == changed.choices(())


@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: str(block.number))
def test_a_block_comes_back_from_its_row_as_it_was(block: Block) -> None:
    config = PositionerConfig.model_validate(SIMULATED_KEYS)
    table = {item.number: item for item in BLOCKS}
    rows = {number: row_of(item) for number, item in table.items()}
    found = PositionerValues(config, (), {}, rows).choices()
    assert block in found.blocks


def test_values_that_do_not_fit_together_are_told() -> None:
    config = PositionerConfig.model_validate(SIMULATED_KEYS)
    with pytest.raises(GatewayError, match="software_limits"):
        PositionerValues(config, (), {2580: 5, 2581: 5}, {}).choices()
    row = row_of(Block(1, 0, 100, next=BlockNext.CONTINUE_WITH_STOP))
    with pytest.raises(GatewayError, match="block 2, which is missing"):
        PositionerValues(config, (), {}, {1: row}).choices()
    with pytest.raises(GatewayError, match="P2623"):
        PositionerValues(config, (), {}, {1: (*row[:-1], 0x200)}).choices()


def test_the_configured_blocks_are_there_to_read() -> None:
    config = PositionerConfig.model_validate(SIMULATED_KEYS)
    values = PositionerValues(config, (BlockConfig(number=3, position=9, velocity=8),), {}, {})
    assert values.row(3)[:3] == (3, 9, 8)
    assert values.row(4)[0] == -1


def test_a_written_parameter_is_in_force_and_kept(tmp_path: Path) -> None:
    config = CONFIG.model_copy(update={"store": tmp_path / "store.json"})
    with serving(config) as (daemon, client):
        assert read(client, 2571) == 30_000
        assert not write(client, 2571, 12_000).failed
        assert (read(client, 2571), choices(daemon).max_velocity) == (12_000, 12_000)
    with serving(config) as (daemon, client):
        assert (read(client, 2571), choices(daemon).max_velocity) == (12_000, 12_000)


def test_a_block_is_made_by_its_parameters_and_run() -> None:
    with serving(CONFIG) as (daemon, client):
        for pnu, value in ((2617, 5000), (2618, 6000), (2616, 9)):
            assert not write(client, pnu, value, block=9).failed
        assert Block(9, 5000, 6000) in choices(daemon).blocks
        plc = Plc(daemon, [111])
        plc.enable()
        plc.endpoint.set(0, {"STW1": 0x043F, "OVERRIDE": 0x4000, "POS_STW1": 9})
        for _ in range(5):
            plc.exchange()
        plc.endpoint.set(0, {"STW1": 0x047F})
        plc.until(lambda: abs(plc.value("XIST_A") - 5000) <= 1, "the block's end")


def test_what_is_refused_changes_nothing() -> None:
    with serving(CONFIG) as (daemon, client):
        before = choices(daemon)
        assert error(write(client, 2571, 0)) == Number.LIMIT_EXCEEDED
        assert error(write(client, 2580, 1_000_000)) == Number.VALUE_IMPERMISSIBLE
        assert error(write(client, 2616, 8, block=9)) == Number.VALUE_IMPERMISSIBLE
        (answer,) = client.request([ParameterAddress(2617, 128, 1)])
        assert error(answer) == Number.FAULTY_SUBINDEX
        assert choices(daemon) == before


def test_an_axis_becomes_a_modulo_axis_by_parameters() -> None:
    with serving(CONFIG) as (daemon, client):
        assert (read(client, 2576), read(client, 2577)) == (0, 0)
        assert error(write(client, 2577, 1)) == Number.VALUE_IMPERMISSIBLE, "no range"
        assert not write(client, 2576, 10_000).failed
        assert error(write(client, 2577, 1)) == Number.VALUE_IMPERMISSIBLE, "software limits"
        for pnu, place in zip((2580, 2581), DataType.INTEGER32.integer_range, strict=True):
            assert not write(client, pnu, place).failed
        assert not write(client, 2577, 1).failed
        assert choices(daemon).modulo == 10_000
        assert not write(client, 2577, 0).failed
        assert choices(daemon).modulo == 0


def test_in_operation_nothing_is_written() -> None:
    with serving(CONFIG) as (daemon, client):
        plc = Plc(daemon, [111])
        plc.enable()
        with exchanging(plc):
            assert error(write(client, 2571, 12_000)) == Number.NOT_EXECUTABLE_IN_STATE


def test_values_are_put_back_if_the_axis_is_switched_on_while_they_are_stored(monkeypatch: pytest.MonkeyPatch) -> None:
    with serving(CONFIG) as (daemon, client):
        saved: list[int] = []
        monkeypatch.setattr(Axis, "powered", property(lambda _: len(saved) == 1))
        update = daemon.store.update

        def switched_on_after(change: Callable[[DeviceParameters], None]) -> None:
            update(change)
            saved.append(1)

        monkeypatch.setattr(daemon.store, "update", switched_on_after)
        assert error(write(client, 2571, 12_000)) == Number.NOT_EXECUTABLE_IN_STATE
        assert (read(client, 2571), choices(daemon).max_velocity) == (30_000, 30_000)


def test_an_axis_without_a_positioner_has_none_of_them() -> None:
    with serving(configuration(axis(1))) as (_, client):
        (answer,) = client.request([ParameterAddress(2571, 0, 0)])
        assert answer.failed


def test_the_parameters_are_in_the_list_and_described() -> None:
    with serving(CONFIG) as (_, client):
        (listed,) = client.request([ParameterAddress(980, 0, 99)])
        pages = [int(number) for number in listed.values]
        while pages[-1]:
            (listed,) = client.request([ParameterAddress(pages.pop(), 0, 99)])
            pages += [int(number) for number in listed.values]
        assert {*ITEMS, *BLOCK_ITEMS} <= set(pages)
        assert DataType.INTEGER32 is ITEMS[2580].spec.type
