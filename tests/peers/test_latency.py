"""Latency of a simulated drive: commands apply late, the Statusword is shown late, in order and to the millisecond."""

from __future__ import annotations

from collections import Counter
from random import Random

import pytest

from pdgw.base.durations import MS
from pdgw.ds301.communication import NmtCommand
from pdgw.dsp402.states import State, state_of
from pdgw.gateway.base.errors import GatewayError
from pdgw.peers.drive import Latency, SimulatedDrive
from pdgw.peers.simulation.config import add_device, parse_bus
from pdgw.peers.simulation.devices import Simulation
from pdgw.peers.world import World
from tests.support.drives.drive_bench import NODE, Bench
from tests.support.drives.latency import draw_latency

RPDO1 = 0x200 + NODE


def operating(latency: Latency) -> Bench:
    """A drive in operation at 0 rpm, then with this latency."""
    bench = Bench()
    bench.enable()
    bench.run(200)
    bench.model.latency = latency
    bench.frames.clear()
    return bench


def order(bench: Bench, word: int, speed: int = 0) -> None:
    bench.node.receive(RPDO1, word.to_bytes(2, "little") + speed.to_bytes(4, "little", signed=True), bench.now)


def time_of(bench: Bench, shown: bool, state: State) -> int:
    """Milliseconds until the drive is in a state, or until its Statusword shows it."""
    for elapsed in range(500):
        if (state_of(bench.model.statusword) if shown else bench.model.state) is state:
            return elapsed
        bench.run(1)
    raise AssertionError(f"never {state.value}")


@pytest.mark.parametrize("delay", [1, 20, 100])
def test_rpdo_applies_after_command_latency(delay: int) -> None:
    bench = operating(Latency(command_ms=delay))
    order(bench, 0x06)
    assert time_of(bench, False, State.READY_TO_SWITCH_ON) == delay


@pytest.mark.parametrize("delay", [1, 20, 100])
def test_statusword_shows_state_after_status_latency(delay: int) -> None:
    bench = operating(Latency(status_ms=delay))
    order(bench, 0x06)
    assert bench.model.state is State.READY_TO_SWITCH_ON
    assert time_of(bench, True, State.READY_TO_SWITCH_ON) == delay


def test_both_latencies_add_up() -> None:
    bench = operating(Latency(30, 40))
    order(bench, 0x06)
    assert time_of(bench, True, State.READY_TO_SWITCH_ON) == 70


def test_velocity_is_up_to_date_while_statusword_is_late() -> None:
    bench = operating(Latency(status_ms=100))
    order(bench, 0x0F, 1000)
    bench.run(50)
    assert bench.model.velocity_actual > 0


def test_short_pulse_passes_in_order_and_unshortened() -> None:
    bench = operating(Latency(40, 40))
    seen: list[tuple[int, State]] = []
    bench.model.watchers.append(lambda state: seen.append((bench.now // MS, state)))
    begin = bench.now // MS
    for word in (0x06, 0x07, 0x0F):
        order(bench, word)
        bench.run(2)
    bench.run(60)
    states = (State.READY_TO_SWITCH_ON, State.SWITCHED_ON, State.OPERATION_ENABLED)
    assert seen == [(begin + 40 + 2 * step, state) for step, state in enumerate(states)]


def test_shorter_latency_lets_no_command_overtake() -> None:
    bench = operating(Latency(command_ms=80))
    order(bench, 0x06)
    bench.model.latency = Latency()
    order(bench, 0x07)
    bench.run(79)
    assert bench.model.state is State.OPERATION_ENABLED
    bench.run(1)
    assert bench.model.state is State.SWITCHED_ON


def test_connection_loss_drops_commands_on_their_way() -> None:
    bench = operating(Latency(command_ms=100))
    order(bench, 0x0F, 3000)
    bench.node.receive(0, bytes((NmtCommand.ENTER_PRE_OPERATIONAL, NODE)), bench.now)
    bench.run(500)
    assert bench.model.target_velocity == 0


def test_power_off_with_commands_on_their_way_asks_for_no_poll() -> None:
    bench = operating(Latency(command_ms=50))
    order(bench, 0x0F, 3000)
    bench.node.power_off()
    bench.run(60)
    assert bench.node.next_event(bench.now) is None
    bench.node.restart()
    bench.run(60)
    assert bench.model.target_velocity == 0


def test_tpdo_with_late_statusword_is_sent_when_it_changes() -> None:
    """The drive is woken for it: nothing else happens at that moment."""
    world = World()
    drive = world.drive("bus", NODE, latency=Latency(status_ms=70))
    seen: list[tuple[int, int]] = []
    world.bus("bus").taps.append(
        lambda now, member, can_id, data: seen.append((now, data[0])) if can_id == 0x180 + NODE else None
    )
    world.loop.run_for(10 * MS)
    master = world.bus("bus").join("master")
    master.send(0, bytes((NmtCommand.START, NODE)))
    world.loop.run_for(200 * MS)
    seen.clear()
    begin = world.loop.now()
    master.send(RPDO1, b"\x06\0\0\0\0\0")
    world.loop.run_for(200 * MS)
    assert drive.model.state is State.READY_TO_SWITCH_ON
    first = next(now for now, status in seen if status & 0x6F == 0x21)
    assert 70 * MS <= first - begin < 73 * MS


def test_drawn_latencies_cover_none_short_and_long() -> None:
    chance = Random(1)
    drawn = Counter(
        "none" if value == 0 else "short" if value <= 10 else "long"
        for latency in (draw_latency(chance) for _ in range(200))
        for value in (latency.command_ms, latency.status_ms)
    )
    assert min(drawn["none"], drawn["short"], drawn["long"]) > 60


BUS_FILE = """
[[device]]
type = "{kind}"
node_id = 3
command_latency_ms = {command}
status_latency_ms = 25
"""


def test_bus_file_sets_latency_of_a_drive() -> None:
    world = World()
    simulation = Simulation(world.loop)
    (device,) = parse_bus(BUS_FILE.format(kind="drive", command=15)).device
    add_device(simulation, device, world.bus("bus").join("node 3"))
    made = simulation.device(3)
    assert isinstance(made, SimulatedDrive)
    assert made.model.latency == Latency(15, 25)


@pytest.mark.parametrize(
    ("kind", "command", "told"), [("drive", 101, "100"), ("encoder", 15, "allowed only with type")]
)
def test_bus_file_with_wrong_latency_is_rejected(kind: str, command: int, told: str) -> None:
    with pytest.raises(GatewayError, match=told):
        parse_bus(BUS_FILE.format(kind=kind, command=command))
