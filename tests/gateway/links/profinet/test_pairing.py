"""The controller's frame and the input frame in one turn of the loop: phases, drifting clocks, late frames, and the answer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.loop.virtual_loop import VirtualLoop
from pdgw.gateway.links.profinet.pairing import Pairing
from pdgw.profidrive.telegrams import telegram
from pdgw.profinet.blocks.connect_blocks import TICK_NS
from pdgw.profinet.connection.connect import IocrType
from pdgw.profinet.connection.ppm import Provider
from pdgw.profinet.discovery import lldp
from pdgw.profinet.rpc.dcerpc import ACYCLIC_PORT
from tests.gateway.links.profinet.test_link import AXIS, Rig, cyclic
from tests.profinet.connection.test_cyclic import PLACES
from tests.support.gateways.daemon import axis
from tests.support.gateways.profinet_daemon import OFF, ON, configuration, plant
from tests.support.wire.ethernet import FakeEthernet
from tests.support.wire.profinet import DEVICE_MAC, PLC_IP, PLC_MAC, project


@dataclass
class Simulated:
    """Results of a controller's frames."""

    wakes: list[int] = field(default_factory=list)
    """When a frame woke the loop."""
    waits: list[int] = field(default_factory=list)
    """How long each frame waited."""
    sent: list[int] = field(default_factory=list)
    """When input frames were due."""


def simulate(clock: int, ratio: int, phase: int, arrivals: Sequence[int]) -> Simulated:
    """Frames that come at these times, input frames that begin at ``phase``."""
    plan = project(send_clock=clock, reduction_ratio=ratio).plan(IocrType.INPUT, 0x8001)
    provider = Provider(plan, PLC_MAC, DEVICE_MAC, PLACES)
    provider.start(phase)
    port = FakeEthernet(VirtualLoop())
    pairing = Pairing(port, provider)
    simulated = Simulated()
    waiting: list[int] = []
    for arrival in arrivals:
        while provider.due <= arrival:
            due = provider.due
            if pairing.due(due):
                pairing.taken(due, found=bool(waiting))
                simulated.waits += [due - came for came in waiting]
                waiting.clear()
            simulated.sent.append(due)
            assert provider.poll(due) is not None
            if port.listening and waiting:  # as the kernel reports readable data
                simulated.waits += [due - came for came in waiting]
                waiting.clear()
                simulated.wakes.append(due)
                pairing.came(due)
        if port.listening:
            simulated.wakes.append(arrival)
            simulated.waits.append(0)
            pairing.came(arrival)
        else:
            waiting.append(arrival)
    return simulated


@given(
    st.sampled_from([(8, 1), (16, 1), (32, 1), (32, 2), (32, 4), (32, 8)]),
    st.integers(0, 8 * MS),
    st.integers(-100, 100),
)
def test_the_frames_of_any_phase_and_of_a_drifting_clock_are_soon_taken_together(
    rate: tuple[int, int], phase: int, drift_ppm: int
) -> None:
    clock, ratio = rate
    cycle = clock * ratio * TICK_NS
    begin, settled = 32 * MS, 32 * MS + 100 * cycle
    drift = cycle * drift_ppm // 1_000_000
    simulated = simulate(clock, ratio, phase, range(begin, settled + 4 * SECOND, cycle + drift))
    late = [when for when in simulated.wakes if when > settled]
    assert len(late) <= 16 + 4 * SECOND // cycle // 8, "some are needed to follow a clock that drifts"
    drifted = SECOND // 2 // cycle * abs(drift)
    wait = min(MS // 10, cycle // 8)
    assert max(simulated.waits) <= wait + wait // 2 + drifted + cycle // 64
    periods = [later - earlier for earlier, later in pairwise(simulated.sent)]
    assert max(abs(period - cycle) for period in periods) <= cycle // 64


def test_a_clock_as_good_as_ours_wakes_the_loop_twice_a_second() -> None:
    simulated = simulate(32, 1, 300_000, range(MS, 10 * SECOND, MS))
    assert len([when for when in simulated.wakes if when > SECOND]) <= 2 * 9 + 1


@given(st.lists(st.integers(-400_000, 400_000), min_size=50, max_size=300))
def test_a_frame_that_comes_any_time_is_taken_at_the_next_input_frame_at_the_latest(jitter: list[int]) -> None:
    arrivals = sorted((number + 2) * MS + shift for number, shift in enumerate(jitter))
    simulated = simulate(32, 1, 0, arrivals)
    assert max(simulated.waits) <= MS + MS // 64


def test_a_long_cycle_lets_each_frame_wake_the_loop(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.plc.project = replace(rig.plc.project, reduction_ratio=16, data_hold=100)
    rig.connect()
    rig.run(2 * SECOND, lambda: not rig.port.listening)
    assert rig.port.listening


# -- in the link ------------------------------------------------------------------------------------------------------


class PairedRig(Rig):
    """Its drive objects show their setpoints, or the gateway ends with the next frame."""

    ending = False
    at_once = 0
    """Input frames that left as soon as they had their answer."""

    def on_link(self) -> None:
        if self.ending:
            if not self.port.closed:
                self.link.close()
        elif self.link.receive(self.loop.now()):
            self.cycles += 1
            setpoints = self.link.setpoints[0]
            if setpoints is not None:
                before = len(self.port.sent)
                self.link.send([setpoints, (0, 0, 0, 0)], [True, True], 0)
                self.at_once += len(self.port.sent) - before


@pytest.fixture
def rig(tmp_path: Path) -> PairedRig:
    made = PairedRig(tmp_path)
    made.connect()
    made.run(500 * MS, lambda: not made.port.listening)
    assert not made.port.listening
    return made


def test_input_frames_carry_the_answer_to_the_frame_they_are_taken_with(rig: PairedRig) -> None:
    half = telegram(1).actuals
    for number in range(20):
        rig.plc.set_output(AXIS, half.encode((0x047F, number)))
        assert rig.plc.provider is not None
        before = rig.plc.provider.due
        rig.run(20 * MS, lambda number=number: rig.plc.input(AXIS) == half.encode((0x047F, number)))  # type: ignore[misc]
        assert rig.loop.now() - before <= MS // 2, "at the heels of the frame"


def test_input_frames_wait_for_nothing_that_follows_the_answer(rig: PairedRig) -> None:
    rig.plc.set_output(AXIS, telegram(1).actuals.encode((0x047F, 1)))
    rig.run(8 * MS)
    before = rig.at_once
    rig.run(80 * MS)
    assert rig.at_once - before in {19, 20, 21}


def test_a_frame_that_is_missing_makes_the_next_one_wake_the_loop(rig: PairedRig) -> None:
    rig.plc.silent = True
    rig.run(5 * MS)
    assert rig.port.listening
    rig.plc.silent = False
    cycles = rig.cycles
    rig.run(40 * MS)
    assert rig.cycles - cycles >= 9
    assert not rig.port.listening


def test_the_end_of_the_relationship_lets_the_next_one_begin_as_the_first(rig: PairedRig) -> None:
    rig.plc.release(rig.loop.now())
    rig.run(20 * MS)
    assert rig.port.listening
    rig.connect()
    rig.run(500 * MS, lambda: not rig.port.listening)
    assert not rig.port.listening


def test_an_end_while_the_frame_is_taken_sends_and_asks_for_nothing_more(rig: PairedRig) -> None:
    rig.ending = True
    rig.run(8 * MS)
    assert rig.port.closed
    sent = len(rig.port.sent)
    rig.loop.run_for(2 * lldp.INTERVAL_NS)
    assert len(rig.port.sent) == sent


def test_a_call_does_not_overtake_the_frame_that_waits(rig: PairedRig) -> None:
    rig.run(8 * MS)
    before = rig.cycles
    rig.port.real_time.append(cyclic(rig, bytes.fromhex("047f0001")))
    rig.port.arrive((PLC_IP, ACYCLIC_PORT), bytes(100))
    rig.loop.run_for(0)
    assert rig.cycles == before + 1


def test_frames_after_changed_orders_do_not_stay_one_cycle_late(tmp_path: Path) -> None:
    """The gateway was held up while the control word changed several times: all frames are used by the next cycle."""
    with plant(configuration(axis(1), tmp_path / "store.json", transport="watchdog_factor = 75")) as site:
        site.connect()
        site.enable(1, 0x1000)
        site.run(SECOND)
        provider = site.plc.provider
        assert not site.port.listening
        assert provider is not None
        words = (OFF, ON, OFF, ON, OFF)
        for word in words:
            site.set(1, word, 0x1000)
            frame = provider.poll(provider.due)
            assert frame is not None
            site.port.real_time.append(bytes(frame))
        site.loop._now += len(words) * 4 * MS
        site.run(4 * MS)
        assert not site.port.real_time
        assert site.link.setpoints[0] == (OFF, 0x1000)


# -- frames of the buses ----------------------------------------------------------------------------------------------


def paired(clock: int) -> tuple[Pairing, Provider]:
    """A pairing whose next frame is taken together with the input frame."""
    plan = project(send_clock=clock, reduction_ratio=1).plan(IocrType.INPUT, 0x8001)
    provider = Provider(plan, PLC_MAC, DEVICE_MAC, PLACES)
    provider.start(0)
    pairing = Pairing(FakeEthernet(VirtualLoop()), provider)
    pairing.came(provider.due - MS // 10)
    assert not pairing.due(provider.due)
    assert provider.poll(provider.due) is not None
    return pairing, provider


def test_loop_wakes_earlier_by_the_time_for_reading_what_waits() -> None:
    pairing, provider = paired(32)
    assert pairing.lead == 0
    for _ in range(100):
        woken = provider.due - pairing.lead
        assert pairing.due(woken)
        pairing.taken(woken + MS // 5, found=True)
        provider.poll(provider.due)
    assert 0.9 * MS / 5 < pairing.lead <= MS / 5
    assert pairing.wake(provider.due) == provider.due - pairing.lead
    assert pairing.wake(provider.due - 1) == provider.due - 1, "of something else"
    assert pairing.again(provider.due - 1), "the frame may come until the input frame is due"
    assert not pairing.again(provider.due)
    pairing.taken(provider.due, found=False)
    assert pairing.lead == 0


@pytest.mark.parametrize("ratio", [1, 8])
def test_frames_of_the_buses_wait_for_short_cycles_only(tmp_path: Path, ratio: int) -> None:
    rig = Rig(tmp_path)
    rig.plc.project = replace(rig.plc.project, reduction_ratio=ratio, data_hold=100)
    rig.connect()
    assert not rig.link.takes_together
    rig.run(2 * SECOND, lambda: not rig.port.listening)
    assert rig.link.takes_together is (ratio == 1)


def test_cycle_reads_the_buses_while_paired_and_each_frame_wakes_after_a_loss(tmp_path: Path) -> None:
    with plant(configuration(axis(1), tmp_path / "store.json")) as site:
        site.connect()
        site.enable(1, 0x1000)
        received: list[int] = []
        (network,) = site.daemon.networks.values()
        network.listeners.append(lambda message: received.append(site.loop.now()) if message.is_rx else None)
        site.run(SECOND)
        received.clear()
        begin = site.daemon.cycles
        site.run(100 * MS)
        assert len(received) > len(set(received)) / 2
        assert len(set(received)) <= site.daemon.cycles - begin + 1
        site.killed = True
        site.run(20 * MS)
        received.clear()
        begin = site.daemon.cycles
        site.run(100 * MS)
        assert len(set(received)) > site.daemon.cycles - begin
