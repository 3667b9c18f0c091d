"""The device side of the cyclic exchange: which frames count, the watchdog, and the frames sent back."""

from __future__ import annotations

import socket
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.loop.arrivals import arrival
from pdgw.ds301.loop.system_loop import SystemLoop
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.base.udp import UdpSocket
from pdgw.gateway.links.cyclic import CyclicEndpoint
from pdgw.gateway.links.losses import RepeatedLosses
from pdgw.gateway.links.new_frames import Verdict
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.profidrive import frame as rt
from pdgw.profidrive.telegrams import Direction, telegram

PLC = ("127.0.0.1", 40000)
OTHER = ("127.0.0.1", 40001)
CYCLE = 4 * MS


def device(*numbers: int, peer: str | None = None, previous: CyclicEndpoint | None = None) -> CyclicEndpoint:
    return CyclicEndpoint([telegram(n) for n in numbers or (1,)], cycle_ns=CYCLE, peer=peer, previous=previous)


def frame(
    counter: int = 1, *, status: int = rt.STATUS_NORMAL, iops: int = rt.IOPS_GOOD, frame_id: int = 0xC001
) -> bytes:
    c_sdu = bytes.fromhex("047F2000") + bytes((iops, rt.IOPS_GOOD))
    return rt.RtFrame(frame_id, c_sdu, counter, status).encode()


STEP = CYCLE // rt.COUNTER_UNIT_NS


def connect(endpoint: CyclicEndpoint, data: bytes = frame(), source: tuple[str, int] = PLC, at: int = 0) -> None:
    assert endpoint.receive(data, source, at) is Verdict.ACCEPTED


def test_the_first_frame_gives_the_setpoints() -> None:
    endpoint = device()
    connect(endpoint)
    assert endpoint.setpoints == [(0x047F, 0x2000)]
    assert endpoint.peer == PLC


@pytest.mark.parametrize(
    ("data", "verdict"),
    [
        (frame()[:-1], Verdict.TRUNCATED),
        (b"", Verdict.TRUNCATED),
        (frame() + b"\0", Verdict.OVERSIZED),
        (bytes(2000), Verdict.OVERSIZED),
        (frame(frame_id=0xC002), Verdict.WRONG_FRAME_ID),
        (frame(status=rt.STATUS_NORMAL & ~rt.STATUS_DATA_VALID), Verdict.NOT_VALID),
        (frame(status=rt.STATUS_NORMAL & ~rt.STATUS_PRIMARY), Verdict.NOT_PRIMARY),
    ],
)
def test_bad_frames_are_counted_by_their_reason_and_dropped(data: bytes, verdict: Verdict) -> None:
    endpoint = device()
    assert endpoint.receive(data, PLC, 0) is verdict
    assert endpoint.counts.frames[verdict] == 1
    assert endpoint.setpoints == [None]
    assert not endpoint.connected


def test_a_shorter_telegram_in_a_frame_of_the_same_length_leaves_the_axis_without_setpoints() -> None:
    """Where the IOPS of telegram 9 belongs, telegram 1 has padding, which is BAD."""
    endpoint = device(9)
    connect(endpoint)
    assert endpoint.setpoints == [None]
    assert endpoint.counts.iops_bad == 1


def test_a_longer_telegram_in_a_frame_of_the_same_length_is_dropped() -> None:
    plc = PlcEndpoint([telegram(9)], CYCLE)
    plc.set(0, {"STW1": 0x047E, "MDI_ACC": 0x4000})
    endpoint = device(1)
    assert endpoint.receive(bytes(plc.build()), PLC, 0) is Verdict.WRONG_TELEGRAM
    assert endpoint.setpoints == [None]


@pytest.mark.parametrize("advance", [0, -1, -STEP, 61441])
def test_a_counter_that_is_not_newer_is_dropped(advance: int) -> None:
    endpoint = device()
    connect(endpoint, frame(1000))
    assert endpoint.receive(frame(1000 + advance & 0xFFFF), PLC, MS) is Verdict.STALE


def test_the_counter_wraps() -> None:
    endpoint = device()
    connect(endpoint, frame(0xFFF0))
    assert endpoint.receive(frame(0x0010), PLC, MS) is Verdict.ACCEPTED


def test_a_foreign_sender_is_dropped_while_the_peer_is_there() -> None:
    endpoint = device()
    connect(endpoint)
    assert endpoint.receive(frame(2), OTHER, MS) is Verdict.FOREIGN_SENDER
    assert endpoint.peer == PLC


def test_after_the_watchdog_the_first_sender_is_taken_with_any_counter() -> None:
    endpoint = device()
    connect(endpoint, frame(500))
    assert endpoint.poll(3 * CYCLE) is False
    assert endpoint.poll(3 * CYCLE + 1) is True
    assert endpoint.poll(3 * CYCLE + 2) is False, "told once"
    assert endpoint.setpoints == [None]
    assert endpoint.counts.watchdog_expiries == 1
    connect(endpoint, frame(3), OTHER, 20 * CYCLE)


def test_a_sender_that_has_become_the_plc_is_not_named_as_another_one() -> None:
    endpoint = device()
    connect(endpoint)
    endpoint.receive(frame(2), OTHER, MS)
    assert endpoint.finding() is not None
    endpoint.poll(3 * CYCLE + 1)
    connect(endpoint, frame(3), OTHER, 4 * CYCLE)
    assert endpoint.finding() is None


def test_a_configured_peer_is_the_only_one() -> None:
    endpoint = device(peer="127.0.0.9")
    assert endpoint.receive(frame(), PLC, 0) is Verdict.FOREIGN_SENDER
    connect(endpoint, frame(), ("127.0.0.9", 1))


def test_provider_stop_is_a_loss_but_not_a_watchdog_expiry() -> None:
    endpoint = device()
    connect(endpoint)
    assert endpoint.receive(frame(2, status=rt.STATUS_STOP), PLC, MS) is Verdict.PROVIDER_STOP
    assert endpoint.setpoints == [None]
    assert endpoint.connected


def test_iops_bad_is_a_loss_for_that_axis_only() -> None:
    endpoint = device(1, 1)
    c_sdu = bytes.fromhex("047F2000 00 047E1000 80 8080")
    connect(endpoint, rt.RtFrame(0xC001, c_sdu, 1).encode())
    assert endpoint.setpoints == [None, (0x047E, 0x1000)]
    assert endpoint.counts.iops_bad == 1
    answer = endpoint.build([(0, 0), (0, 0)], [True, True])
    layout = rt.CSduLayout([telegram(1)] * 2, Direction.ACTUAL)
    assert [answer[i] for i in layout.iocs] == [rt.IOPS_BAD, rt.IOPS_GOOD]


def test_a_plc_that_is_silent_but_for_invalid_frames_is_lost() -> None:
    endpoint = device()
    connect(endpoint)
    for n in range(1, 5):
        endpoint.receive(frame(1 + n, status=rt.STATUS_NORMAL & ~rt.STATUS_DATA_VALID), PLC, n * CYCLE)
    assert endpoint.poll(4 * CYCLE)


def test_a_frame_that_came_in_time_counts_though_the_gateway_looked_when_the_watchdog_had_run_out() -> None:
    endpoint = device()
    connect(endpoint)
    endpoint.poll(2 * CYCLE)
    late = 3 * CYCLE + MS
    assert endpoint.receive(frame(1 + 3 * STEP), PLC, late, 3 * CYCLE) is Verdict.ACCEPTED
    assert not endpoint.poll(late)


@pytest.mark.parametrize("stamp", [2 * CYCLE + 2 * MS, None])
def test_a_frame_that_came_too_late_is_a_loss_however_early_the_next_look(stamp: int | None) -> None:
    endpoint = device()
    connect(endpoint)
    endpoint.poll(3 * CYCLE - 1)
    if stamp is None:
        # Nothing was there when the socket was looked at after the watchdog time: whatever is there now came later.
        endpoint.receive(b"", OTHER, 3 * CYCLE + 1)
    now = 3 * CYCLE + MS
    assert endpoint.receive(frame(1 + 3 * STEP), PLC, now, stamp and 3 * CYCLE + 1) is not Verdict.ACCEPTED
    assert endpoint.setpoints == [None]
    assert endpoint.poll(now)


def test_without_time_stamps_a_frame_may_have_come_in_time_while_the_gateway_was_not_late() -> None:
    endpoint = device()
    connect(endpoint)
    endpoint.poll(2 * CYCLE)
    assert endpoint.receive(frame(1 + 3 * STEP), PLC, 3 * CYCLE + MS) is Verdict.ACCEPTED


@pytest.mark.parametrize("stamped", [False, True])
def test_a_gateway_that_was_paused_ignores_frames_that_waited(stamped: bool) -> None:
    """The queue has all frames of a PLC that stopped, was switched on again and ended."""
    endpoint = device()
    connect(endpoint)
    now = 100 * CYCLE
    for number in range(1, 95):
        data = frame(1 + number * STEP)
        assert endpoint.receive(data, PLC, now, number * CYCLE if stamped else None) is not Verdict.ACCEPTED
        assert endpoint.setpoints == [None]
    assert endpoint.poll(now), "the drive objects see the loss"
    assert not endpoint.connected
    for number in range(95, 100):
        endpoint.receive(frame(1 + number * STEP), PLC, now, number * CYCLE if stamped else None)
    assert endpoint.counts.watchdog_expiries == 1


def test_a_frame_that_waited_longer_than_the_watchdog_time_is_not_used() -> None:
    endpoint = device()
    connect(endpoint)
    endpoint.poll(2 * CYCLE)
    now = 4 * CYCLE
    assert endpoint.receive(frame(1 + STEP), PLC, now, now - 3 * CYCLE - 1) is Verdict.OVERDUE
    assert endpoint.poll(now)


def test_a_connection_waits_for_the_report_of_the_loss() -> None:
    """Without this rule the axes would continue with an ON and never see the loss."""
    endpoint = device()
    connect(endpoint)
    assert endpoint.receive(frame(2), PLC, 20 * CYCLE) is Verdict.AFTER_LOSS
    assert (endpoint.connected, endpoint.setpoints) == (False, [None])
    assert endpoint.poll(20 * CYCLE), "the loss"
    assert endpoint.receive(frame(3), PLC, 21 * CYCLE) is Verdict.ACCEPTED
    assert endpoint.setpoints == [(0x047F, 0x2000)]


def test_newer_on_of_a_later_reading_waits_for_the_report_of_the_loss() -> None:
    """The daemon may read its socket twice before the axes step."""
    endpoint = device()
    connect(endpoint)
    for reading in (20, 21, 22):
        now = reading * CYCLE
        assert endpoint.receive(frame(1 + reading * STEP), PLC, now, now) is Verdict.AFTER_LOSS
        assert (endpoint.connected, endpoint.setpoints) == (False, [None])
    assert endpoint.poll(22 * CYCLE), "the loss"
    assert endpoint.counts.watchdog_expiries == 1
    connect(endpoint, frame(1 + 23 * STEP), at=23 * CYCLE)


def test_loss_that_no_axis_has_seen_outlasts_another_layout() -> None:
    first = device(1)
    connect(first)
    assert first.receive(frame(2), PLC, 20 * CYCLE) is Verdict.AFTER_LOSS
    second = device(1, previous=first)
    assert second.receive(frame(3), PLC, 21 * CYCLE) is Verdict.AFTER_LOSS
    assert second.poll(21 * CYCLE), "the loss"
    connect(second, frame(4), at=22 * CYCLE)


def test_the_answer_carries_values_status_and_a_running_counter() -> None:
    endpoint = device()
    first = rt.RtFrame.decode(bytes(endpoint.build([(0x0637, -5)], [True])))
    assert first.frame_id == rt.FRAME_ID_TO_CONTROLLER
    assert first.c_sdu[:6] == bytes.fromhex("0637FFFB 80 00")
    assert first.data_status == rt.STATUS_NORMAL
    second = rt.RtFrame.decode(bytes(endpoint.build([(0, 0)], [False])))
    assert (second.cycle_counter - first.cycle_counter) * rt.COUNTER_UNIT_NS == CYCLE
    assert second.c_sdu[4] == rt.IOPS_BAD


def test_an_endpoint_with_another_telegram_continues_to_count() -> None:
    """A restarted cycle counter would look like old frames to the PLC."""
    first = device(1)
    connect(first)
    for _ in range(5):
        before = first.build([(0, 0)], [True])
    second = device(2, previous=first)
    after = second.build([(0,) * len(telegram(2).actuals.signals)], [True])
    counters = [rt.RtFrame.decode(bytes(data)).cycle_counter for data in (before, after)]
    assert rt.is_newer(counters[1], counters[0])
    assert (second.counts.sent, second.counts.frames[Verdict.ACCEPTED]) == (6, 1)
    assert second.setpoints == [None], "values of the other telegram are not taken over"


def test_a_configured_peer_may_come_back_from_another_port_after_the_watchdog() -> None:
    endpoint = device(peer=PLC[0])
    connect(endpoint, frame(5))
    assert endpoint.receive(frame(6), OTHER, MS) is Verdict.FOREIGN_SENDER
    endpoint.poll(4 * CYCLE)
    connect(endpoint, frame(1), OTHER, 10 * CYCLE)


@given(data=st.binary(max_size=100))
def test_arbitrary_datagrams_never_raise_and_are_always_counted(data: bytes) -> None:
    endpoint = device()
    endpoint.receive(data, PLC, 0)
    assert sum(endpoint.counts.frames.values()) == 1


def test_a_time_stamp_of_the_kernel_becomes_a_time_of_the_loop_whatever_happens_to_the_wall_clock() -> None:
    wall, now, earliest = 10**18, 5_000 * MS, 4_990 * MS
    assert arrival(wall - 3 * MS, wall, now, earliest) == now - 3 * MS
    assert arrival(wall + 3600 * 10**9, wall, now, earliest) == now, "set back by an hour while the datagram waited"
    assert arrival(wall - 3600 * 10**9, wall, now, earliest) == earliest, "set forward by an hour"


@pytest.mark.skipif(sys.platform != "linux", reason="time stamps of Linux")
def test_a_datagram_that_waits_in_the_socket_keeps_the_time_at_which_it_came() -> None:
    loop = SystemLoop()
    port = UdpSocket(loop, "127.0.0.1", 0, "test")
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as plc:
            times = []
            for data in (b"first", b"second"):
                times.append(loop.now())
                plc.sendto(data, port.address)
            times.append(loop.now())
        for number, data in enumerate((b"first", b"second")):
            before = loop.now()
            received = port.receive()
            meanwhile = loop.now() - before  # between its looks at both clocks it may have to wait for the processor
            assert received is not None
            assert received[0] == data
            assert port.received_at is not None
            assert times[number] - MS <= port.received_at <= times[number + 1] + MS + meanwhile
        assert port.receive() is None
    finally:
        port.close()


@pytest.mark.parametrize(
    ("times", "pauses", "said"),
    [
        ([1, 2, 3], [20 * MS] * 3, "20 ms apart, the limit is 12 ms"),
        ([1, 2, 3], [30 * MS, 15 * MS, 20 * MS], "15 to 30 ms apart"),
        ([1, 2], [20 * MS] * 2, ""),
        ([1, 7, 12], [20 * MS] * 3, ""),
        ([1, 2, 3], [2 * SECOND] * 3, ""),
        ([1, 2, 3], [12 * MS] * 3, ""),
    ],
)
def test_three_pauses_in_ten_seconds_are_one_reason(times: list[int], pauses: list[int], said: str) -> None:
    """Rare losses, a cable that is pulled, and frames inside the limit are none."""
    losses = RepeatedLosses(12 * MS)
    for time, pause in zip(times, pauses, strict=True):
        losses.returned(time * SECOND, pause)
    now = times[-1] * SECOND
    found = losses.finding(now)
    assert (found is not None) == bool(said)
    if found is not None:
        assert said in found.evidence
        assert losses.finding(now + 10 * SECOND - 1) is not None
        assert losses.finding(now + 10 * SECOND) is None, "it ends without further losses"


def test_repeated_losses_are_reported_once_a_minute_with_their_number() -> None:
    losses, reported = RepeatedLosses(12 * MS), list[str]()
    for time in range(100):
        losses.returned(time * SECOND, 20 * MS)
        reported.append(losses.report("lost", time * SECOND))
    assert reported[:2] == ["lost", "lost"]
    assert [(time, text.rpartition(" (")[2]) for time, text in enumerate(reported[2:], 2) if text] == [
        (2, "3 times in 2 s)"),
        (62, "63 times in 62 s)"),
    ]
    assert losses.report("lost", 200 * SECOND) == "lost", "the next one is alone"


def test_plc_that_begins_is_not_lost_because_an_idle_gateway_read_seldom() -> None:
    """An idle gateway reads every 20 ms, longer than the watchdog time: that delays nothing of a PLC that begins."""
    endpoint = device()
    endpoint.poll(20 * MS)
    now = 40 * MS
    assert endpoint.receive(frame(), PLC, now, now - MS) is Verdict.ACCEPTED
    assert endpoint.receive(frame(1 + STEP), PLC, now, now) is Verdict.ACCEPTED
    assert not endpoint.poll(now)
    assert endpoint.counts.watchdog_expiries == 0


def test_pause_of_the_plc_is_one_loss_also_if_a_frame_shows_it_first() -> None:
    endpoint = device()
    now, counter = SECOND, 1
    for pauses in range(1, 4):
        for cycle in range(100):
            now += 13 * MS if cycle == 50 else CYCLE
            counter = counter + STEP & 0xFFFF
            endpoint.poll(now - MS)
            endpoint.receive(frame(counter), PLC, now, now)
            endpoint.poll(now)
        assert endpoint.counts.watchdog_expiries == pauses
        assert (endpoint.finding() is None) == (pauses < 3)


def test_silence_after_a_copy_of_the_last_frame_is_not_the_fault_of_the_copy() -> None:
    """A network that repeats frames, and then a pulled cable."""
    endpoint = device()
    connect(endpoint)
    assert endpoint.receive(frame(), PLC, CYCLE // 2) is Verdict.STALE
    assert endpoint.poll(4 * CYCLE)
    assert endpoint.finding() is None
    counting = device()
    connect(counting)
    for number in range(1, 4):
        assert counting.receive(frame(), PLC, number * CYCLE) is Verdict.STALE
    assert counting.poll(4 * CYCLE)
    finding = counting.finding()
    assert finding is not None
    assert finding.reason is Reason.FRAME_COUNTER


def test_frames_that_did_not_count_are_no_longer_named_when_none_come() -> None:
    endpoint = device()
    endpoint.receive(frame()[:-1], PLC, SECOND)
    found = endpoint.finding()
    assert found is not None
    assert found.reason is Reason.FRAME_LAYOUT
    endpoint.poll(11 * SECOND)
    assert endpoint.finding() is not None
    endpoint.poll(11 * SECOND + 1)
    assert endpoint.finding() is None


def test_frames_of_another_sender_are_not_the_cause_of_a_later_silence() -> None:
    endpoint = device()
    connect(endpoint)
    assert endpoint.receive(frame(5), ("10.0.0.7", 1), MS) is Verdict.FOREIGN_SENDER
    assert endpoint.receive(frame(1 + STEP), PLC, CYCLE) is Verdict.ACCEPTED
    assert endpoint.poll(5 * CYCLE)
    assert endpoint.lost_by is None


def test_frames_of_another_sender_after_a_loss_do_not_explain_it() -> None:
    endpoint = device()
    connect(endpoint, at=CYCLE)
    assert endpoint.poll(10 * CYCLE)
    assert endpoint.receive(b"", ("10.0.0.7", 1), 11 * CYCLE) is Verdict.TRUNCATED
    finding = endpoint.finding()
    assert finding is not None
    assert finding.reason is Reason.OTHER_SENDER
    assert endpoint.receive(b"", PLC, 12 * CYCLE) is Verdict.TRUNCATED
    finding = endpoint.finding()
    assert finding is not None
    assert finding.reason is Reason.FRAME_LAYOUT
