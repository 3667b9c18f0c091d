"""PDOs of encoders whose mapping or transmission type is their own: by the data sheet, and by their answers."""

from __future__ import annotations

import operator
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest

from pdgw.base.durations import MS
from pdgw.ds301.eds.writer import write_eds
from pdgw.ds301.objects import Access, ObjectAddress, ObjectSpec
from pdgw.dsp406.device import device_info, encoder_objects
from pdgw.dsp406.encoder import EncoderClient, EncoderSheet
from pdgw.dsp406.kinds import MULTI_SENSOR, ROTARY, EncoderDevice
from pdgw.dsp406.settings import EncoderSettings
from pdgw.peers.encoder import SimulatedEncoder
from pdgw.peers.encoder.motion import constant_speed
from pdgw.peers.node.pdos import NodePdos
from tests.dsp406.plant import NODE, Plant, fresh
from tests.support.gateways import site

POSITION, SPEED, AREA, CAMS = 0x6004_0020, 0x6030_0110, 0x6400_0108, 0x6300_0108
NO_SPEED = "Speed value 6030h/1 not available in a PDO: the speed is the mean speed of the position"
POLLED = "TPDO1 not used: its transmission type 253 is neither on SYNC nor event-driven, and cannot be written"
BY_TIMER = "on change and by event timer"


def mapping(index: int, *mapped: int) -> dict[ObjectAddress, dict[str, Any]]:
    """A fixed mapping."""
    values = (len(mapped), *mapped, *[0] * (8 - len(mapped)))
    return {(index, sub): {"access": Access.RO, "default": value} for sub, value in enumerate(values)}


def sent(index: int, type_: int) -> dict[ObjectAddress, dict[str, Any]]:
    """A fixed transmission type."""
    return {(index, 2): {"access": Access.RO, "default": type_}}


@dataclass(frozen=True)
class Habit:
    """What is special about an encoder, and the plan that it gets."""

    name: str
    changes: dict[ObjectAddress, dict[str, Any]]
    plan: tuple[str, ...]
    lacks: Sequence[int] = ()
    device: EncoderDevice = ROTARY
    sync: bool = False
    channels: tuple[int, ...] = field(default=(1,))

    def __str__(self) -> str:
        return self.name

    @property
    def objects(self) -> tuple[ObjectSpec, ...]:
        """The objects of such an encoder."""
        return tuple(
            replace(spec, entries=tuple(replace(item, **self.changes.get(item.address, {})) for item in spec.entries))
            for spec in encoder_objects(self.device)
            if spec.index not in self.lacks
        )

    def settings(self, eds: Path | None) -> dict[str, Any]:
        """Those of its client."""
        return {"device": self.device, "channels": self.channels, "sync": self.sync, "eds": eds}


HABITS = (
    Habit(
        "fixed mapping with the position alone",
        mapping(0x1A00, POSITION) | mapping(0x1A02, POSITION),
        (f"TPDO1 189h: Position value 6004h; {BY_TIMER}; its own mapping", NO_SPEED),
    ),
    Habit(
        "fixed mapping on SYNC",
        mapping(0x1A00, POSITION) | mapping(0x1A02, POSITION),
        ("TPDO1 189h: Position value 6004h; on SYNC; its own mapping", NO_SPEED),
        sync=True,
    ),
    Habit(
        "fixed mapping with position and speed",
        mapping(0x1A00, POSITION, SPEED) | mapping(0x1A02, POSITION),
        (f"TPDO1 189h: Position value 6004h, Speed value 6030h/1; {BY_TIMER}; its own mapping",),
    ),
    Habit(
        "fixed mapping with unneeded objects",
        mapping(0x1A00, AREA, POSITION, CAMS) | mapping(0x1A02, POSITION),
        (f"TPDO1 189h: Position value 6004h; {BY_TIMER}; its own mapping", NO_SPEED),
    ),
    Habit(
        "position and speed in two fixed TPDOs",
        mapping(0x1A00, SPEED) | mapping(0x1A02, POSITION),
        (
            f"TPDO3 389h: Position value 6004h; {BY_TIMER}; its own mapping",
            f"TPDO1 189h: Speed value 6030h/1; {BY_TIMER}; its own mapping",
        ),
    ),
    Habit(
        "fixed mapping without the position",
        mapping(0x1A00, AREA) | mapping(0x1A02, CAMS),
        ("read by SDO every 100 ms: Position value 6004h", NO_SPEED),
    ),
    Habit(
        "speed that cannot be mapped",
        {(0x6030, 1): {"pdo": False}},
        (f"TPDO1 189h: Position value 6004h; {BY_TIMER}", NO_SPEED),
    ),
    Habit(
        "no TPDO",
        {},
        ("read by SDO every 100 ms: Position value 6004h", NO_SPEED),
        lacks=(0x1800, 0x1802, 0x1A00, 0x1A02),
    ),
    Habit(
        "TPDO on remote request beside another one",
        sent(0x1800, 253),
        (f"TPDO3 389h: Position value 6004h, Speed value 6030h/1; {BY_TIMER}", POLLED),
    ),
    Habit(
        "TPDO on remote request beside one on SYNC",
        sent(0x1800, 252) | sent(0x1802, 1),
        (
            "TPDO3 389h: Position value 6004h, Speed value 6030h/1; on SYNC",
            POLLED.replace("253", "252"),
            "TPDO3 on SYNC: its transmission type cannot be written",
        ),
    ),
    Habit(
        "all TPDOs on remote request",
        sent(0x1800, 253) | sent(0x1802, 253),
        ("read by SDO every 100 ms: Position value 6004h", POLLED, POLLED.replace("TPDO1", "TPDO3"), NO_SPEED),
    ),
    Habit(
        "TPDO for each 20th SYNC",
        sent(0x1800, 20),
        (
            "TPDO1 189h: Position value 6004h, Speed value 6030h/1; on SYNC",
            "TPDO1 on SYNC: its transmission type cannot be written",
        ),
    ),
    Habit(
        "TPDO on SYNC after a change",
        sent(0x1800, 0) | sent(0x1802, 0),
        (
            "TPDO1 189h: Position value 6004h, Speed value 6030h/1; on change only, and also read by SDO",
            "read by SDO every 100 ms: Position value 6004h, Speed value 6030h/1",
            "TPDO1 on SYNC after a change only: its transmission type cannot be written; heartbeat and SDO monitor the device",
        ),
    ),
    Habit(
        "two channels in one fixed TPDO",
        mapping(0x1A00, 0x6020_0120, 0x6020_0220)
        | {key: values for n in (1, 2, 3) for key, values in mapping(0x1A00 + n).items()},
        (
            "TPDO1 189h: Position values for multi-sensor devices 6020h/1, Position values for multi-sensor devices "
            f"6020h/2; {BY_TIMER}; its own mapping",
            NO_SPEED,
            NO_SPEED.replace("6030h/1", "6030h/2"),
        ),
        device=MULTI_SENSOR,
        channels=(1, 2),
    ),
)


def sheet(habit: Habit, folder: Path) -> Path:
    """The data sheet of such an encoder."""
    eds = folder / "own.eds"
    eds.write_text(write_eds(device_info(habit.device), habit.objects), encoding="ascii")
    return eds


def fit(encoder: SimulatedEncoder, objects: Iterable[ObjectSpec]) -> None:
    """Give a simulated encoder other objects before power-on."""
    node = encoder.node
    node.entries = {entry.address: entry for spec in objects for entry in spec.entries}
    node.indices = {index for index, _ in node.entries}
    node.values.clear()
    node.pdos = NodePdos(node)
    node._defaults()


def online(plant: Plant, habit: Habit, eds: Path | None, *, turns: bool = True, **settings: object) -> EncoderClient:
    """Bring up such an encoder."""
    encoder = plant.power_on(*(constant_speed(turns * number) for number in habit.channels), device=habit.device)
    fit(encoder, habit.objects)
    encoder.start()
    client = plant.connect(**habit.settings(eds), **settings)

    def cycle() -> bool:
        if habit.sync or (client.plan is not None and client.plan.needs_sync):
            plant.network.send_sync()
        return client.generation > 0

    site.wait_for(cycle, f"online ({client.status_text})")
    return client


def positions(client: EncoderClient) -> list[int]:
    """The newest position of each channel."""
    return [channel.position for channel in fresh(client).feedback.channels.values()]


@pytest.mark.parametrize("habit", HABITS, ids=str)
def test_data_sheet_shows_the_plan_of_the_bring_up(habit: Habit, plant: Plant, tmp_path: Path) -> None:
    eds = sheet(habit, tmp_path)
    assert EncoderSheet(EncoderSettings(NODE, **habit.settings(eds))).plan().lines == habit.plan
    client = online(plant, habit, eds)
    assert client.plan is not None
    assert client.plan.lines == habit.plan


@pytest.mark.parametrize("habit", HABITS, ids=str)
def test_encoder_has_the_same_plan_if_its_data_sheet_hides_the_habit(habit: Habit, plant: Plant) -> None:
    client = online(plant, habit, None)
    assert client.plan is not None
    # A mapping that is right already was not found to be fixed.
    own = "; its own mapping"
    assert [line.removesuffix(own) for line in client.plan.lines] == [line.removesuffix(own) for line in habit.plan]
    before = positions(client)

    def moved() -> bool:
        plant.network.send_sync()
        return all(map(operator.gt, positions(client), before))

    site.wait_for(moved, "motion")
    for channel in filter(client.has_speed, habit.channels):
        assert client.feedback.channel(channel).speed == channel * ROTARY.resolution


@pytest.mark.parametrize("habit", [item for item in HABITS if "SYNC" in item.name], ids=str)
@pytest.mark.parametrize("turns", [True, False])
def test_encoder_on_sync_is_fresh_between_its_tpdos(habit: Habit, turns: bool, plant: Plant) -> None:
    """A SYNC comes every 2 ms, so a TPDO every 2 or 40 ms, or none at standstill."""
    client = online(plant, habit, None, turns=turns, cycle_ms=2, tpdo_event_ms=2, tpdo_timeout_factor=25)
    for _ in range(1000):
        plant.network.send_sync()
        site.pass_time(2 * MS)
        assert client.refresh(site.now())
    assert client.generation == 1
    site.pass_time(161 * MS)
    assert not client.refresh(site.now()) or not any(slot.watched for slot in client.operation.slots), (
        "without SYNC it is overdue"
    )
