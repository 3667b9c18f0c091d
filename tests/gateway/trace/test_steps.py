"""The recorded steps, which are those of the machines whatever the frames of their devices have."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from pdgw.base.durations import MS
from pdgw.ds301.communication import STORE_PARAMETERS
from pdgw.gateway.axis.orders import Brake
from pdgw.gateway.axis.values import Inputs, Outputs, SdoWrite
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.trace import pcapng
from pdgw.gateway.trace.steps import StepRecord, step_record
from pdgw.peers.drive import shape
from tests.support.gateways.daemon import (
    OFF,
    ON,
    SIMULATED_POSITIONER,
    Plc,
    axis,
    configuration,
    drive_of,
    encoder_of,
    operating,
    until,
    world_of,
)
from tests.support.gateways.recorded_daemon import differences, recorded, recording, replay_of
from tests.support.gateways.seen_steps import SeenSteps

TWO_BYTES = 2
DERIVED = {"fresh", "position_ns", "standstill", "standstill_unknown", "now", "saturations"} | {
    "speed_asked_ns",
    "speed_until_ns",
    "position_asked_ns",
    "position_old",
}
"""The frames have them, the machine sets them, or they change only where the speed is read by SDO."""


def numbers(item: object) -> list[str]:
    names = [name for name in dir(item) if name.islower() and not name.startswith("_")]
    return [name for name in names if isinstance(getattr(item, name), int) and name not in DERIVED]


def test_a_step_is_recorded_if_a_value_changes_that_no_frame_has() -> None:
    """Also a value that is added to inputs or outputs one day."""
    with operating() as (daemon, plc):
        item = daemon.axes[0]
        item.given = []
        record = step_record(item)

        def taken() -> int:
            plc.exchange()
            return len(record.take(item.machine.inputs.now))

        assert taken() > TWO_BYTES
        assert taken() == TWO_BYTES
        for image in (item.machine.inputs, item.machine.outputs):
            for name in numbers(image):
                before = getattr(image, name)
                other = Brake.NMT_STOP if name == "brake" else not before if isinstance(before, bool) else before + 1
                setattr(image, name, other)
                assert len(record.take(item.machine.inputs.now)) > TWO_BYTES, name
                setattr(image, name, before)
                assert len(record.take(item.machine.inputs.now)) > TWO_BYTES, name
        item.machine.outputs.reason = Reason.PLC_STOP
        assert len(record.take(item.machine.inputs.now)) > TWO_BYTES
        item.fault_log.count += 1
        assert len(record.take(item.machine.inputs.now)) > TWO_BYTES
        item.drive.generation += 1
        assert len(record.take(item.machine.inputs.now)) > TWO_BYTES
        item.given.append(("tolerate", 3))
        assert len(record.take(item.machine.inputs.now)) > TWO_BYTES
        item.machine.outputs.presets[0] = SdoWrite(0x607C, 0, 5)
        assert len(record.take(item.machine.inputs.now)) > TWO_BYTES
        assert len(record.take(item.machine.inputs.now)) == TWO_BYTES
        assert numbers(Inputs(item.drive.feedback))
        assert numbers(Outputs(0, None))


def turn(plc: Plc, cycles: int = 150) -> None:
    """All axes turn at changing speeds; the first one starts and stops."""
    for index in range(len(plc.daemon.axes)):
        plc.endpoint.set(index, {"STW1": OFF | 1 << 7})
    plc.exchange(20)
    for index in range(len(plc.daemon.axes)):
        plc.enable(index)
    for number in range(cycles):
        for index, item in enumerate(plc.daemon.axes):
            name = "NSOLL_A" if item.telegram.number in (1, 2) else "NSOLL_B"
            plc.endpoint.set(index, {name: (0x400 + 16 * number) << (0 if name == "NSOLL_A" else 16)})
        plc.exchange()
    plc.endpoint.set(0, {"STW1": OFF})
    plc.exchange(60)
    plc.enable()


def with_losses(plc: Plc) -> None:
    turn(plc, 30)
    plc.silent = True
    plc.exchange(100)
    plc.silent = False
    plc.endpoint.bad = {0}
    plc.exchange(10)
    plc.endpoint.bad = set()
    plc.enable()
    plc.endpoint.run = False
    plc.exchange(10)
    plc.endpoint.run = True
    plc.enable()
    plc.daemon.stop()
    for _ in range(400):
        plc.endpoint.set(0, {"NSOLL_A": 7})
        if not plc.daemon.stopped.is_set():
            plc.exchange()


def restarts(plc: Plc) -> None:
    """The drive restarts in operation, is silent, loses its wire."""
    turn(plc, 30)
    drive = drive_of(plc.daemon)
    drive.node.restart()
    plc.exchange(300)
    turn(plc, 10)
    drive.do(lambda node: node.start_fault("lost-pdos", every=1))
    plc.exchange(100)
    drive.do(lambda node: node.end_fault())
    plc.exchange(300)
    turn(plc, 10)
    port = world_of(plc.daemon).gateway_port("world")
    port.connect(False)
    plc.exchange(100)
    port.connect(True)
    plc.exchange(300)
    turn(plc, 10)


def tasks(plc: Plc) -> None:
    """Jogging of a positioner: setpoints that wait for their data."""
    plc.enable()
    for word in (ON | 1 << 8, ON, ON | 1 << 9, ON, ON & ~2):
        plc.endpoint.set(0, {"STW1": word})
        plc.exchange(60)


def sensors(plc: Plc) -> None:
    """An encoder turns, restarts and is lost while the axis turns."""
    turn(plc, 60)
    encoder_of(plc.daemon).node.restart()
    plc.exchange(250)
    turn(plc, 60)


def in_pairs(plc: Plc) -> None:
    """Two frames arrive at one time, as after a delay in the network. The second command, or its data alone, waits for room on
    the bus."""
    turn(plc, 10)
    plc.enable()
    for number in range(60):
        for value in (0x400 + 32 * number, 0x410 + 32 * number):
            plc.endpoint.set(0, {"NSOLL_B": (number if number % 2 else value) << 16, "MOMRED": value})
            plc.send()
        plc.exchange(2)


def speed_before_on(plc: Plc) -> None:
    """The setpoint is there when the drive starts, which shows its mode of operation only later."""
    plc.endpoint.set(0, {"NSOLL_A": 0x1000})
    plc.enable()
    plc.exchange(100)


def stores(plc: Plc) -> None:
    """The PLC changes the torque limit while the drive stores its own one, and gets none meanwhile."""
    plc.enable()
    stored = []
    for number in range(150):
        plc.endpoint.set(0, {"MOMRED": 20 * number})
        if number % 10 == 5:
            drive = plc.daemon.axes[0].drive
            stored.append(drive.submit(lambda drive: drive.write_for_client(STORE_PARAMETERS, 1, b"save")))
        plc.exchange()
    assert all(job.done() for job in stored)


SMALL = '[can]\ninterface = "virtual"\nchannel = "world"\nbitrate = 1000000\n'
ENCODER = "[[encoder]]\ndo_id = 9\nnode_id = 20\ntelegram = 83\nsimulate = true\n"
SECOND = ENCODER.replace("9", "8").replace("20", "21")
CASES: dict[str, tuple[str, str, str | None, Callable[[Plc], None]]] = {
    "RPDOs wait for room": ("".join(axis(n, telegram_number=3) for n in range(1, 7)), SMALL, None, turn),
    "RPDOs wait for room, and two frames at one time": (
        axis(1, telegram_number=102),
        SMALL,
        None,
        in_pairs,
    ),
    "losses and the end of the gateway": (axis(1), "", None, with_losses),
    "restarts": (axis(1), "", None, restarts),
    "encoders as G1 and G2": (
        axis(1, telegram_number=4, more="simulate = true\ng1 = 9\ng2 = 8") + ENCODER + SECOND,
        "",
        None,
        sensors,
    ),
    "a limit withheld while the drive stores its own": (axis(1, telegram_number=102), "", None, stores),
    "speed withheld until the drive shows its mode": (axis(1, more=""), "", "mode-late", speed_before_on),
    "setpoints held for their data": (axis(1, telegram_number=111, more=SIMULATED_POSITIONER), "", None, tasks),
    **{
        f"telegram {number} and the drive {name}": (axis(1, telegram_number=number, more=""), "", name, turn)
        for name, number in itertools.product(("fixed-pdo", "no-event-timer", "vl", "mode-late", "four-pdo"), (1, 3))
    },
}


@pytest.mark.parametrize("name", CASES)
def test_a_recording_has_the_steps_of_the_machines(name: str, tmp_path: Path) -> None:
    tables, can, of_shape, happens = CASES[name]
    seen: list[SeenSteps] = []

    def before(daemon: Daemon) -> None:
        seen.append(SeenSteps(daemon))
        if of_shape:
            world_of(daemon).drive("world", 1, shape=shape(of_shape))
        if can:
            world_of(daemon).gateway_port("world").places = 2

    with recorded(configuration(tables, can=can), tmp_path, before) as plc:
        until(plc.daemon, lambda: all(client.generation for client in plc.daemon.clients), "online", 20_000 * MS)
        happens(plc)
        assert not can or all(network.waits for network in plc.daemon.networks.values())
    by_frames = seen[0].compare(recording(tmp_path))
    assert not differences(replay_of(tmp_path))
    assert by_frames > 100


def test_steps_of_an_axis_that_moves_need_five_bytes_a_cycle(tmp_path: Path) -> None:
    """Also with telegram 1, whose position is read by SDO."""
    with recorded(configuration(axis(1)), tmp_path) as plc:
        turn(plc)
        first = plc.daemon.cycles
        plc.exchange(1250)
        steps = [
            len(data) - pcapng.CYCLE_HEAD.size
            for number, data in cycle_blocks(recording(tmp_path))
            if number > first + 10
        ]
    assert len(steps) > 1000
    assert sum(steps) / len(steps) < 5


@pytest.mark.planted
def test_the_pdos_are_described_once_and_recorded_every_second(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Their description takes as long as a hundred steps, and with 64 axes longer than a cycle."""
    described: list[object] = []
    describe = StepRecord._find_pdos

    def counted(record: StepRecord) -> object:
        described.append(record)
        return describe(record)

    monkeypatch.setattr(StepRecord, "_find_pdos", counted)
    with recorded(configuration(axis(1)), tmp_path) as plc:
        turn(plc, 800)
        generations = plc.daemon.axes[0].drive.generation
    texts = [data for _, data in cycle_blocks(recording(tmp_path)) if b'"pdos"' in data]
    assert len(described) == 1 + generations
    assert len(texts) > 3


def cycle_blocks(file: str) -> Iterator[tuple[int, bytes]]:
    """Number and content of the cycles in a recording."""
    data = Path(file).read_bytes()
    for kind, at, _ in pcapng.walk(data):
        if kind == pcapng.CUSTOM:
            *_, content, size = pcapng.CUSTOM_HEAD.unpack_from(data, at)
            begin = at + pcapng.CUSTOM_HEAD.size
            if content == pcapng.CYCLE:
                yield pcapng.CYCLE_HEAD.unpack_from(data, begin)[0], data[begin : begin + size]
