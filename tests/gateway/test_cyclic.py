"""The device side of the cyclic exchange: which frames count, the watchdog, and the frames sent back."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pdgw.gateway.transport.cyclic import CyclicEndpoint, Verdict
from pdgw.peers.plc.endpoint import PlcEndpoint
from pdgw.profidrive import frame as rt
from pdgw.profidrive.telegrams import Direction, telegram

PLC = ("127.0.0.1", 40000)
OTHER = ("127.0.0.1", 40001)
MS = 1_000_000
CYCLE = 4 * MS


def device(*numbers: int, peer: str | None = None) -> CyclicEndpoint:
    return CyclicEndpoint([telegram(n) for n in numbers or (1,)], cycle_ns=CYCLE, peer=peer)


def frame(
    counter: int = 1, *, status: int = rt.STATUS_NORMAL, iops: int = rt.IOPS_GOOD, frame_id: int = 0xC001
) -> bytes:
    c_sdu = bytes.fromhex("047F2000") + bytes((iops, rt.IOPS_GOOD))
    return rt.RtFrame(frame_id, c_sdu, counter, status).encode()


def test_a_valid_frame_gives_the_setpoints() -> None:
    endpoint = device()
    assert endpoint.receive(frame(), PLC, 0) is Verdict.ACCEPTED
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
    assert endpoint.counters[verdict] == 1
    assert endpoint.setpoints == [None]
    assert not endpoint.connected


def test_a_shorter_telegram_in_a_frame_of_the_same_length_leaves_the_axis_without_setpoints() -> None:
    """Telegram 100 just fills the minimum C_SDU: where its IOPS belongs, telegram 1 has padding, which is BAD."""
    endpoint = device(100)
    endpoint.receive(frame(), PLC, 0)
    assert endpoint.setpoints == [None]
    assert endpoint.iops_bad == 1


def test_a_longer_telegram_in_a_frame_of_the_same_length_is_dropped() -> None:
    plc = PlcEndpoint([telegram(9)], CYCLE)
    plc.set(0, {"STW1": 0x047E, "MDI_ACC": 0x4000})
    endpoint = device(1)
    assert endpoint.receive(bytes(plc.build()), PLC, 0) is Verdict.WRONG_TELEGRAM
    assert endpoint.setpoints == [None]


@pytest.mark.parametrize("counter", [10, 9, 0, 10 + 61441])
def test_a_stale_counter_is_dropped(counter: int) -> None:
    endpoint = device()
    endpoint.receive(frame(10), PLC, 0)
    assert endpoint.receive(frame(counter & 0xFFFF), PLC, MS) is Verdict.STALE


def test_the_counter_wraps() -> None:
    endpoint = device()
    endpoint.receive(frame(0xFFF0), PLC, 0)
    assert endpoint.receive(frame(0x0010), PLC, MS) is Verdict.ACCEPTED


def test_a_foreign_sender_is_dropped_while_the_peer_is_there() -> None:
    endpoint = device()
    endpoint.receive(frame(1), PLC, 0)
    assert endpoint.receive(frame(2), OTHER, MS) is Verdict.FOREIGN_SENDER
    assert endpoint.peer == PLC


def test_after_the_watchdog_the_first_valid_sender_and_any_counter_are_taken() -> None:
    endpoint = device()
    endpoint.receive(frame(500), PLC, 0)
    assert endpoint.poll(3 * CYCLE) is False
    assert endpoint.poll(3 * CYCLE + 1) is True
    assert endpoint.poll(3 * CYCLE + 2) is False, "told once"
    assert endpoint.setpoints == [None]
    assert endpoint.watchdog_expiries == 1
    assert endpoint.receive(frame(3), OTHER, 20 * CYCLE) is Verdict.ACCEPTED


def test_a_configured_peer_is_the_only_one() -> None:
    endpoint = device(peer="127.0.0.9")
    assert endpoint.receive(frame(), PLC, 0) is Verdict.FOREIGN_SENDER
    assert endpoint.receive(frame(), ("127.0.0.9", 1), 0) is Verdict.ACCEPTED


def test_provider_stop_is_a_loss_but_not_a_watchdog_expiry() -> None:
    endpoint = device()
    endpoint.receive(frame(1), PLC, 0)
    assert endpoint.receive(frame(2, status=rt.STATUS_STOP), PLC, MS) is Verdict.PROVIDER_STOP
    assert endpoint.setpoints == [None]
    assert endpoint.connected


def test_iops_bad_is_a_loss_for_that_axis_only() -> None:
    endpoint = device(1, 1)
    c_sdu = bytes.fromhex("047F2000 00 047E1000 80 8080")
    endpoint.receive(rt.RtFrame(0xC001, c_sdu, 1).encode(), PLC, 0)
    assert endpoint.setpoints == [None, (0x047E, 0x1000)]
    assert endpoint.iops_bad == 1
    answer = endpoint.build([(0, 0), (0, 0)], [True, True])
    layout = rt.CSduLayout([telegram(1)] * 2, Direction.ACTUAL)
    assert [answer[i] for i in layout.iocs] == [rt.IOPS_BAD, rt.IOPS_GOOD]


def test_a_plc_that_is_silent_but_for_invalid_frames_is_lost() -> None:
    endpoint = device()
    endpoint.receive(frame(1), PLC, 0)
    for n in range(1, 5):
        endpoint.receive(frame(1 + n, status=rt.STATUS_NORMAL & ~rt.STATUS_DATA_VALID), PLC, n * CYCLE)
    assert endpoint.poll(4 * CYCLE)


def test_the_answer_carries_values_status_and_a_running_counter() -> None:
    endpoint = device()
    first = rt.RtFrame.decode(bytes(endpoint.build([(0x0637, -5)], [True])))
    assert first.frame_id == rt.FRAME_ID_TO_CONTROLLER
    assert first.c_sdu[:6] == bytes.fromhex("0637FFFB 80 00")
    assert first.data_status == rt.STATUS_NORMAL
    second = rt.RtFrame.decode(bytes(endpoint.build([(0, 0)], [False])))
    assert (second.cycle_counter - first.cycle_counter) * rt.COUNTER_UNIT_NS == CYCLE
    assert second.c_sdu[4] == rt.IOPS_BAD


def test_an_endpoint_with_another_telegram_goes_on_counting() -> None:
    """A cycle counter that starts anew would look like old frames to the PLC."""
    first, second = device(1), device(2)
    first.receive(frame(1), PLC, 0)
    for _ in range(5):
        before = first.build([(0, 0)], [True])
    second.continue_from(first)
    after = second.build([(0,) * len(telegram(2).actuals.signals)], [True])
    counters = [rt.RtFrame.decode(bytes(data)).cycle_counter for data in (before, after)]
    assert rt.is_newer(counters[1], counters[0])
    assert (second.sent, second.counters[Verdict.ACCEPTED]) == (6, 1)
    assert second.setpoints == [None], "values of the other telegram are not taken over"


def test_a_configured_peer_may_come_back_from_another_port_after_the_watchdog() -> None:
    endpoint = device(peer=PLC[0])
    endpoint.receive(frame(5), PLC, 0)
    assert endpoint.receive(frame(6), OTHER, MS) is Verdict.FOREIGN_SENDER
    endpoint.poll(4 * CYCLE)
    assert endpoint.receive(frame(1), OTHER, 5 * CYCLE) is Verdict.ACCEPTED


@pytest.mark.parametrize("counter", [11, 10 + 61440])
def test_the_limits_of_a_newer_counter(counter: int) -> None:
    endpoint = device()
    endpoint.receive(frame(10), PLC, 0)
    assert endpoint.receive(frame(counter & 0xFFFF), PLC, MS) is Verdict.ACCEPTED


@given(data=st.binary(max_size=100))
def test_arbitrary_datagrams_never_raise_and_are_always_counted(data: bytes) -> None:
    endpoint = device()
    endpoint.receive(data, PLC, 0)
    assert sum(endpoint.counters.values()) == 1


@given(
    events=st.lists(
        st.one_of(
            st.tuples(st.just("send"), st.integers(0, 3)),
            st.tuples(st.sampled_from(["lose", "repeat", "late", "wait"]), st.integers(1, 5)),
        ),
        max_size=40,
    )
)
def test_loss_duplicates_and_reordering_never_bring_an_old_setpoint_back(events: list[tuple[str, int]]) -> None:
    """What the axes see is always the newest accepted setpoint or nothing."""
    plc = PlcEndpoint([telegram(1)], CYCLE)
    endpoint = device()
    sent: list[bytes] = []
    newest = 0
    now = 0
    for action, number in events:
        now += MS
        if action in {"send", "lose"}:
            plc.set(0, {"STW1": 0x047E, "NSOLL_A": len(sent) + 1})
            sent.append(bytes(plc.build()))
        if action == "send":
            assert endpoint.receive(sent[-1], PLC, now) is Verdict.ACCEPTED
            newest = len(sent)
        elif action == "repeat" and newest:
            assert endpoint.receive(sent[newest - 1], PLC, now) in {Verdict.STALE, Verdict.ACCEPTED}
        elif action == "late" and newest > number and endpoint.connected:
            assert endpoint.receive(sent[newest - 1 - number], PLC, now) is Verdict.STALE
        elif action == "wait":
            now += number * CYCLE
            endpoint.poll(now)
        values = endpoint.setpoints[0]
        assert values is None or values[1] == newest
