"""Two sequences of frames of one PLC at once, as when the delay of the network falls: a stop of either one acts."""

from __future__ import annotations

import heapq
import logging
import random

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from pdgw.dsp402.states import State
from pdgw.durations import MS
from pdgw.gateway.links.cyclic import CyclicEndpoint
from pdgw.gateway.links.sequence import SEQUENCE_FRAMES, WRAP_NS
from pdgw.profidrive.frame import (
    COUNTER_UNIT_NS,
    FRAME_ID_TO_DEVICE,
    IOPS_BAD,
    IOPS_GOOD,
    STATUS_NORMAL,
    STATUS_STOP,
    RtFrame,
)
from pdgw.profidrive.telegrams import telegram
from tests.support.axis.stepper import Stepper
from tests.support.drives.drive_types import References
from tests.support.drives.plain_drive import PlainDrive
from tests.support.gateways.daemon import Plc as Controller
from tests.support.gateways.daemon import axis, configuration, drive_of, running, world_of

PLC = ("192.168.0.10", 40000)
CYCLE = 4 * MS
WATCHDOG = 3 * CYCLE
OFF, ON = 0x047E, 0x047F
BAD, STOP = -1, -2
"""Instead of a control word: IOPS BAD, provider STOP."""
STOPS = (OFF, 0x047D, 0x047B, 0x0000, 0x046F, 0x045F, 0x043F, 0x0477, 0x007F, BAD, STOP)
BEGIN = 10 * WRAP_NS


class Site:
    """A PLC, a network whose delay the test sets, an endpoint, the machine of an axis and its drive."""

    def __init__(self, number: int = 1, axes: int = 1, cycle: int = CYCLE) -> None:
        self.half = telegram(number).setpoints
        self.cycle = cycle
        self.endpoint = CyclicEndpoint([telegram(number)] * axes, cycle_ns=cycle)
        self.stepper = Stepper(number)
        self.stepper.set_references(References())
        self.drive = PlainDrive()
        self.words = [OFF] * axes
        self.now = BEGIN
        self.paths: tuple[int, ...] = (0,)
        """Delay of each copy of a frame that is sent now."""
        self.jitter = random.Random(1)
        self.uneven = 1
        self.lost = 0.0
        self.losses = 0
        self.newest_at = 0
        """When the last frame came that has the present words."""
        self.shift = 0
        """The PLC counts from elsewhere since it was restarted."""
        self.held = False
        """The gateway reads nothing; then it reads everything at once, with the times of the kernel."""
        self._waiting: list[tuple[int, int, bytes]] = []
        self._number = 0

    @property
    def in_force(self) -> int | None:
        """The first word of the first axis; None: it has no PLC."""
        values = self.endpoint.setpoints[0]
        return None if values is None else values[0]

    @property
    def is_stopped(self) -> bool:
        """The first axis is stopped: by what the PLC sends now, by OFF, by a loss, or it is locked anyway."""
        word, in_force = self.words[0], self.in_force
        stopped = in_force is None or in_force & 0x7 != 0x7 or (word >= 0 and not in_force & ~word & ON)
        return stopped or not self.stepper.power.released

    @property
    def operates(self) -> bool:
        return self.drive.state is State.OPERATION_ENABLED

    def frame(self) -> bytes:
        data = b""
        for word in self.words:
            good = IOPS_BAD if word == BAD else IOPS_GOOD
            data += max(word, 0).to_bytes(2, "big") + bytes(self.half.size - 2) + bytes((good,))
        status = STATUS_STOP if STOP in self.words else STATUS_NORMAL
        counter = self.now // self.cycle * (self.cycle // COUNTER_UNIT_NS) + self.shift & 0xFFFF
        return RtFrame(FRAME_ID_TO_DEVICE, data + bytes(len(self.words)), counter, status).encode()

    def run(self, cycles: int, word: int | None = None) -> None:
        """The PLC sends; ``word``: of all axes from now on."""
        if word is not None:
            self.words = [word] * len(self.words)
        for _ in range(cycles):
            frame = self.frame()
            for delay in self.paths:
                if self.jitter.random() >= self.lost:
                    arrival = self.now + delay + self.jitter.randrange(self.uneven)
                    self._number += 1
                    heapq.heappush(self._waiting, (arrival, self._number, frame))
            self.now += self.cycle
            self.arrive()

    def arrive(self) -> None:
        """What has arrived until now."""
        if self.held:
            return
        end = self.now - 1
        came = []
        while self._waiting and self._waiting[0][0] <= end:
            arrival, _, frame = heapq.heappop(self._waiting)
            came.append((arrival, frame))
        together = bool(came) and end - came[0][0] > CYCLE
        newest = self.frame()[2:-4]
        for arrival, frame in came:
            if frame[2:-4] == newest:
                self.newest_at = arrival
            self.endpoint.receive(frame, PLC, end if together else arrival, arrival)
            if not together:
                self.step(arrival)
        self.step(end)

    def step(self, now: int) -> None:
        self.losses += self.endpoint.poll(now)
        self.stepper.machine.inputs.unconfirmed = self.endpoint.unconfirmed_orders[0]
        actuals = self.stepper.step(self.endpoint.setpoints[0], self.drive.feedback, True, now)
        axes = len(self.words)
        self.endpoint.build([actuals] * axes, [True] * axes, [self.stepper.power.released] * axes)
        self.drive.step(self.stepper.command)


def late(delay: int, number: int = 1, axes: int = 1) -> Site:
    """The axis runs, and each frame comes this late."""
    site = Site(number, axes)
    site.paths = (delay,)
    site.run(100 + delay // CYCLE, OFF)
    site.run(1300, ON)
    assert site.in_force == ON
    return site


DROPS = (20 * MS, 500 * MS, 1100 * MS, WRAP_NS - 8 * MS, WRAP_NS - CYCLE, WRAP_NS, WRAP_NS + 500 * MS, 4900 * MS)


@pytest.mark.parametrize(
    ("drop", "word"), [(drop, word) for drop in DROPS for word in (OFF, STOP)] + [(500 * MS, word) for word in STOPS]
)
def test_a_stop_in_new_frames_acts_while_delayed_frames_still_arrive(drop: int, word: int) -> None:
    site = late(drop)
    site.paths = (0,)
    site.run(SEQUENCE_FRAMES + 1, word)
    assert site.is_stopped
    for _ in range(drop // CYCLE + 100):
        site.run(1)
        assert site.is_stopped
    assert not site.operates


@pytest.mark.parametrize("cycle", [MS // 4, MS, 3 * MS, 32 * MS])
def test_a_stop_acts_with_the_fourth_new_frame_whatever_the_cycle(cycle: int) -> None:
    site = Site(cycle=cycle)
    site.paths = (40 * cycle,)
    site.run(60, OFF)
    site.run(100, ON)
    assert site.operates
    site.paths = (0,)
    site.run(SEQUENCE_FRAMES, 0x047D)
    assert site.in_force is None
    for _ in range(100):
        site.run(1)
        assert site.is_stopped


def test_the_loss_is_told_once_and_by_its_reason() -> None:
    site = late(500 * MS)
    site.paths = (0,)
    site.run(100, OFF)
    assert (site.losses, site.endpoint.watchdog_expiries, site.endpoint.contradicted) == (1, 1, True)
    assert site.endpoint.connected
    site.run(100)
    assert not site.endpoint.connected, "the delayed sequence has ended"
    assert (site.losses, site.endpoint.contradicted) == (2, False)


def test_a_stop_of_another_axis_of_the_frame_stops_all_because_the_frame_as_a_whole_is_in_doubt() -> None:
    site = late(500 * MS, axes=2)
    site.paths = (0,)
    site.words = [ON, OFF]
    site.run(SEQUENCE_FRAMES + 1)
    assert list(site.endpoint.setpoints) == [None, None]


@pytest.mark.parametrize("word", [OFF, 0x047D, 0x047B, ON | 0x0100])
def test_a_controlword_stops_too(word: int) -> None:
    site = late(500 * MS, 100)
    site.paths = (0,)
    site.run(SEQUENCE_FRAMES + 1, word)
    assert site.in_force is None


@pytest.mark.parametrize("delay", [1 * MS, CYCLE, 7 * MS, WATCHDOG - MS])
def test_frames_doubled_within_the_watchdog_time_stop_nothing_and_delay_no_start(delay: int) -> None:
    site = Site()
    site.paths = (0, delay)
    site.run(2000, OFF)
    site.run(1, ON)
    assert site.in_force == ON
    site.run(100)
    assert site.operates
    site.run(1, OFF)
    assert site.in_force == OFF
    site.run(100)
    assert site.losses == 0


def test_every_other_frame_late_by_less_than_the_watchdog_time_stops_nothing() -> None:
    """As over two cables in turn."""
    site = Site()
    site.run(2000, OFF)
    for cycle in range(400):
        site.paths = (cycle % 2 * 6 * MS,)
        site.run(1, ON if cycle % 200 > 50 else OFF)
        assert site.in_force == (ON if cycle % 200 > 51 else site.in_force)
    assert site.losses == 0


def test_fewer_frames_than_a_sequence_stop_nothing() -> None:
    """Three old frames in their rhythm, and single ones at any time."""
    site = Site()
    site.run(1000, OFF)
    site.paths = (0, 500 * MS)
    site.run(SEQUENCE_FRAMES - 1)
    site.paths = (0,)
    site.run(1, ON)
    for _ in range(30):
        site.run(7)
        site.paths = (0, site.jitter.randrange(20 * MS, 5000 * MS))
        site.run(1)
        site.paths = (0,)
    site.run(1300)
    assert site.operates
    assert site.losses == 0


def test_after_a_stop_of_an_old_sequence_only_off_and_then_on_start_the_axis() -> None:
    """Every frame comes again 500 ms later: the OFF of before stops an axis that is ON by now."""
    site = Site()
    site.paths = (0, 500 * MS)
    site.run(1500, OFF)
    site.run(125, ON)
    assert not site.operates, "the second sequence says OFF"
    site.run(50)
    assert site.operates
    site.run(60, OFF)
    site.run(50, ON)
    assert (site.losses, site.operates) == (0, True)
    site.run(50)
    assert (site.losses, site.operates) == (1, False), "the OFF has come again"
    for _ in range(200):
        site.run(1)
        assert not site.operates
    assert site.in_force == ON
    site.paths = (0,)
    site.run(200)
    assert not site.operates
    site.run(10, OFF)
    site.run(10, ON)
    assert site.operates


def test_nothing_starts_that_the_other_sequence_contradicts() -> None:
    """The PLC has sent OFF for long when its OFF and ON of before come, in order and in rhythm."""
    for delay in (500 * MS, 1000 * MS, WRAP_NS + 100 * MS):
        site = late(delay)
        site.run(50, OFF)
        site.run(50, ON)
        site.paths = (0,)
        site.run(10, OFF)
        for _ in range(delay // CYCLE):
            site.run(1)
            assert not site.operates


def test_a_plc_that_restarts_is_obeyed_though_frames_of_its_earlier_life_still_come() -> None:
    for shift in (1, 100, 20_000, 40_000, 65_000):
        site = late(400 * MS)
        site.paths = (0,)
        site.shift = shift
        site.run(SEQUENCE_FRAMES + 1, OFF)
        assert site.is_stopped
        for _ in range(200):
            site.run(1)
            assert site.is_stopped


def test_frames_that_wait_together_do_not_hide_the_loss_from_the_axes() -> None:
    site = late(500 * MS)
    site.paths = (0,)
    site.run(SEQUENCE_FRAMES - 1)
    site.held = True
    site.run(1, OFF)
    site.run(1, ON)
    site.held = False
    site.arrive()
    assert site.losses == 1
    assert not site.stepper.power.released


def test_the_axis_of_a_gateway_stops_says_why_and_the_log_too(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "gateway")
    transport = f'listen = "192.168.0.5"\npeer = "{PLC[0]}"\nwatchdog_factor = 3'
    with running(configuration(axis(1), transport=transport)) as daemon:
        plc = Controller(daemon, [1], PLC[0])
        network = world_of(daemon).network
        network.conditions.delay_ns = 500 * MS
        plc.enable()
        for _ in range(1500):
            plc.exchange()
        caplog.clear()
        network.conditions.delay_ns = MS // 20
        plc.endpoint.set(0, {"STW1": OFF})
        for _ in range(SEQUENCE_FRAMES + 2):
            plc.exchange()
        assert drive_of(daemon).model.state is not State.OPERATION_ENABLED
        told = [record.getMessage() for record in caplog.records]
        assert [text for text in told if text.startswith("PLC")] == [f"PLC lost: {daemon.link.loss}"]
        assert daemon.link.loss.startswith("frames arrive in two sequences")
        assert any("fault 103" in text and daemon.link.loss in text for text in told)


PATHS = st.tuples(
    st.integers(12, 400),
    st.lists(
        st.one_of(
            st.sampled_from([0, MS, 5 * MS, 11 * MS]),
            st.integers(0, 5000 * MS),
            st.integers(-3 * CYCLE, 3 * CYCLE).map(lambda near: WRAP_NS + near),
        ),
        min_size=1,
        max_size=3,
    ),
)


@settings(max_examples=settings().max_examples // 2, phases=[Phase.explicit, Phase.generate])
@given(
    paths=st.lists(PATHS, min_size=1, max_size=6),
    ons=st.lists(st.integers(1, 300), min_size=1, max_size=5),
    stop=st.sampled_from(STOPS),
    at=st.integers(0, 1500),
    uneven=st.sampled_from([1, MS]),
    seed=st.integers(0, 1 << 30),
)
def test_a_stop_that_lasts_acts_after_the_smallest_delay_whatever_old_frames_arrive(
    paths: list[tuple[int, list[int]]], ons: list[int], stop: int, at: int, uneven: int, seed: int
) -> None:
    site = Site()
    site.jitter = random.Random(seed)
    site.uneven = uneven
    site.paths = tuple(paths[0][1])
    site.run(400, OFF)
    words = [word for count in ons for word in [ON] * count + [OFF] * (count // 3)]
    phases = [(tuple(delays), cycles) for cycles, delays in paths]
    sent_with = [delays for delays, cycles in phases for _ in range(cycles)]
    sent_with += [sent_with[-1]] * (at + 1300 - len(sent_with))
    stopped_at = site.now + at * CYCLE
    due = None
    for cycle, delays in enumerate(sent_with):
        site.paths = delays
        site.run(1, stop if cycle >= at else words[cycle % len(words)])
        if cycle >= at and cycle + SEQUENCE_FRAMES < len(sent_with):
            lasting = set(delays).intersection(*sent_with[cycle : cycle + SEQUENCE_FRAMES])
            if lasting:
                acts = site.now + min(lasting) + WATCHDOG + (SEQUENCE_FRAMES + 1) * CYCLE
                due = acts if due is None else min(due, acts)
        if due is not None and site.now > due:
            if site.now - site.newest_at > WATCHDOG:
                break  # every path is slower now: frames that all are late cannot be told from new ones
            assert site.is_stopped, f"{(site.now - stopped_at) / MS} ms after the stop"
