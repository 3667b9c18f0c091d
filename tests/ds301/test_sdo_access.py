"""SDO accesses to a node whose answers are late, doubled, short, of another access, or never end."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future
from typing import TypeVar

import pytest
from canopen.objectdictionary import ODVariable

from pdgw.base.durations import MS
from pdgw.ds301.aborts import Abort, CanopenError, SdoAbortedError, SdoCommunicationError
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.loop.jobs import resolve
from pdgw.ds301.node.sdo import Inquiry
from pdgw.ds301.objects import CanType
from pdgw.ds301.sdo_transfer import Upload
from tests.support.gateways import site

T = TypeVar("T")
NODE, INDEX = 4, 0x6083
ADDRESS, OTHER = b"\x83\x60\0", b"\x84\x60\0"
READ, WRITTEN, VALUE, ABORTED = b"\x40", b"\x60", b"\x43", b"\x80"
CONFIRMATION = WRITTEN + ADDRESS + bytes(4)
TIMEOUT_NS = 100 * MS


class Site:
    """A client, and a node whose answers to a request are those of ``script``."""

    def __init__(self, network: CanNetwork) -> None:
        self.network = network
        self.requests: list[bytes] = []
        self.script: Callable[[bytes], list[bytes]] = lambda _: []
        self.client = Inquiry(network, NODE, TIMEOUT_NS / 1e9)
        self._port = site.other()
        self._port.start(self)

    def on_frame(self, can_id: int, data: bytes, now: int) -> None:
        if can_id == 0x600 + NODE:
            self.requests.append(data)
            self.send(*self.script(data))

    def send(self, *answers: bytes) -> None:
        for answer in answers:
            self._port.send(0x580 + NODE, answer)

    def run(self, job: Callable[[Inquiry], T]) -> T:
        """Run a job in a task."""
        future: Future[T] = Future()
        self.network.loop.spawn(lambda: resolve(future, lambda: job(self.client)), "job")
        return site.result(future, 60)

    def read(self, index: int = INDEX) -> bytes:
        return self.run(lambda node: node.read(index))

    def write(self, value: int, index: int = INDEX) -> None:
        self.run(lambda node: node.write(index, 0, value.to_bytes(4, "little")))


@pytest.fixture
def desk() -> Iterator[Site]:
    with site.guarded_network() as network:
        made = Site(network)
        with made.client:
            yield made


def test_late_confirmation_of_another_object_does_not_confirm_a_write(desk: Site) -> None:
    with pytest.raises(SdoCommunicationError, match="node 4 object 6083h/0: No SDO response received"):
        desk.write(100)
    abort = ABORTED + OTHER + Abort.VALUE_TOO_HIGH.to_bytes(4, "little")
    desk.script = lambda request: [CONFIRMATION, abort] if request[:1] == b"\x23" else []
    with pytest.raises(SdoAbortedError, match="node 4 object 6084h/0: 0609 0031h"):
        desk.write(200, 0x6084)
    assert desk.client.aborts == 1


def test_late_confirmation_of_the_same_object_does_not_confirm_another_value(desk: Site) -> None:
    """The node confirms the first write when the second one arrives, and still has the first value."""
    with pytest.raises(SdoCommunicationError):
        desk.write(100)
    desk.script = lambda request: [VALUE + ADDRESS + b"\x64\0\0\0" if request[:1] == READ else CONFIRMATION]
    with pytest.raises(SdoCommunicationError, match="6083h/0 is 64000000 after the write of c8000000"):
        desk.write(200)
    desk.write(300)


def test_late_confirmation_before_the_own_one_is_followed_by_a_read(desk: Site) -> None:
    """The confirmation of the second write is not the answer to the read."""
    with pytest.raises(SdoCommunicationError):
        desk.write(100)
    value = VALUE + ADDRESS + b"\xc8\0\0\0"
    desk.script = lambda request: [value] if request[:1] == READ else [CONFIRMATION, CONFIRMATION]
    desk.write(200)
    assert desk.requests[-1][:1] == READ


def test_a_repeated_value_is_not_read_back(desk: Site) -> None:
    """1010h: "save" is written, and the object reads as what the node can store."""
    with pytest.raises(SdoCommunicationError):
        desk.write(100)
    desk.script = lambda _: [CONFIRMATION]
    desk.write(100)
    assert desk.requests[-1][:1] == b"\x23"


FOREIGN = [
    ABORTED + b"\x00\x20\x00" + Abort.NO_SUCH_OBJECT.to_bytes(4, "little"),
    VALUE + OTHER + b"\x01\0\0\0",
    VALUE + b"\x83\x60\x01" + b"\x01\0\0\0",
    VALUE + ADDRESS[:2],
]


@pytest.mark.parametrize("foreign", [*FOREIGN, CONFIRMATION])
def test_read_ignores_answers_to_other_requests(desk: Site, foreign: bytes) -> None:
    desk.script = lambda _: [foreign, VALUE + ADDRESS + b"\x05\0\0\0"]
    assert desk.read() == b"\x05\0\0\0"


@pytest.mark.parametrize("foreign", [*FOREIGN, VALUE + ADDRESS + bytes(4)])
def test_write_ignores_answers_to_other_requests(desk: Site, foreign: bytes) -> None:
    desk.script = lambda _: [foreign, CONFIRMATION]
    desk.write(100)
    desk.script = lambda _: [foreign]
    with pytest.raises(SdoCommunicationError):
        desk.write(100)


def test_abort_without_a_name_is_of_the_own_access(desk: Site) -> None:
    desk.script = lambda _: [ABORTED + bytes(3) + Abort.GENERAL.to_bytes(4, "little")]
    with pytest.raises(SdoAbortedError, match="node 4 object 6083h/0: 0800 0000h: general error"):
        desk.read()


def test_short_answers_to_an_urgent_request_are_reported(desk: Site) -> None:
    desk.script = lambda _: [b"\x43"]
    with pytest.raises(ValueError, match="1 bytes, 8 expected"):
        desk.run(lambda node: node.read_urgently(INDEX))


@pytest.mark.parametrize("size", [4, 5, 7])
def test_short_confirmation_of_a_write_is_accepted_with_a_line(
    desk: Site, size: int, caplog: pytest.LogCaptureFixture
) -> None:
    desk.script = lambda _: [CONFIRMATION[:size]]
    with caplog.at_level("INFO"):
        desk.write(100)
        desk.write(200)
    assert caplog.text.count(f"node 4: an SDO confirmation has {size} bytes, 8 expected: accepted") == 1


def test_short_confirmations_of_segments_are_accepted(desk: Site) -> None:
    desk.script = lambda request: [CONFIRMATION[:4] if request[:1] == b"\x21" else bytes((0x20 | request[0] & 0x10,))]
    desk.run(lambda node: node.write(INDEX, 0, bytes(20)))
    assert len(desk.requests) == 4


@pytest.mark.parametrize(
    ("short", "size"),
    [(CONFIRMATION[:3], 3), (WRITTEN + OTHER, 4), (ABORTED + ADDRESS, 4)],
    ids=["no address", "another object", "an abort without its code"],
)
def test_other_short_answer_to_a_write_is_named(desk: Site, short: bytes, size: int) -> None:
    desk.script = lambda _: [short]
    with pytest.raises(SdoCommunicationError, match=f"its answer has {size} bytes, 8 expected"):
        desk.write(100)


def test_urgent_request_is_repeated_and_its_second_answer_is_of_no_other(desk: Site) -> None:
    """The answers to both requests arrive after the second one. The next access waits for the last of them."""
    old, new = VALUE + ADDRESS + b"\x01\0\0\0", VALUE + ADDRESS + b"\x02\0\0\0"
    desk.script = lambda _: [old] if len(desk.requests) == 2 else []
    assert desk.run(lambda node: node.read_urgently(INDEX)) == 1
    assert len(desk.requests) == 2
    desk.network.loop.call_later(20 * MS, lambda: desk.send(old))
    desk.script = lambda _: [new]
    assert desk.read() == b"\x02\0\0\0"


def test_read_without_an_answer_is_repeated_after_the_time_for_a_late_one(desk: Site) -> None:
    desk.client.patient = True
    desk.script = lambda _: [VALUE + ADDRESS + b"\x07\0\0\0"] if len(desk.requests) > 2 else []
    begin = site.now()
    assert desk.read() == b"\x07\0\0\0"
    assert [request[0] for request in desk.requests] == [0x40, 0x80, 0x40], "request, abort, and again"
    assert 2 * TIMEOUT_NS <= site.now() - begin < 3 * TIMEOUT_NS


def test_answer_after_the_end_of_a_read_is_late_and_one_to_another_client_is_not(desk: Site) -> None:
    with pytest.raises(SdoCommunicationError):
        desk.read()
    desk.send(VALUE + OTHER + bytes(4))
    site.pass_time(10 * MS)
    assert not desk.client.answers_late
    desk.send(VALUE + ADDRESS + bytes(4))
    site.pass_time(10 * MS)
    assert desk.client.answers_late


def test_question_without_an_answer_does_not_delay_what_follows_the_next_one(desk: Site) -> None:
    def ask(_: Inquiry) -> None:
        desk.client.ask(INDEX, 0, lambda _: None)

    desk.run(ask)
    assert desk.client.awaits_answer
    site.pass_time(2 * TIMEOUT_NS)
    desk.script = lambda _: [VALUE + ADDRESS + bytes(4)]
    desk.run(ask)
    site.pass_time(10 * MS)
    assert not desk.client.awaits_answer


def test_interrupted_access_ends_at_once_and_none_follows_until_it_is_resumed(desk: Site) -> None:
    begin = site.now()
    desk.network.loop.call_later(10 * MS, desk.client.interrupt)
    with pytest.raises(SdoCommunicationError, match="No SDO response received"):
        desk.read()
    with pytest.raises(SdoCommunicationError, match="node 4 is lost"):
        desk.read()
    assert site.now() - begin < TIMEOUT_NS
    assert [request[:1] for request in desk.requests] == [READ, ABORTED], "aborted in the node too"
    desk.client.resume()
    desk.script = lambda _: [VALUE + ADDRESS + bytes(4)]
    assert desk.read() == bytes(4)


@pytest.mark.parametrize("answers", [1, 30])
def test_interrupted_upload_of_a_long_object_ends_at_once(desk: Site, answers: int) -> None:
    """The answers stop, or continue without end."""
    left = iter(range(answers))
    desk.script = lambda request: segments(request) if next(left, None) is not None else []
    desk.network.loop.call_later(10 * MS, desk.client.interrupt)
    begin = site.now()
    with pytest.raises(SdoCommunicationError):
        desk.read()
    assert site.now() - begin < TIMEOUT_NS
    site.pass_time(MS)
    assert desk.requests[-1][:1] == ABORTED


def test_node_that_answers_each_request_twice_is_two_devices(desk: Site) -> None:
    desk.script = lambda _: 2 * [VALUE + ADDRESS + bytes(4)]

    def read(node: Inquiry) -> None:
        for _ in range(8):
            node.read(INDEX)
            node.loop.sleep(5 * MS)

    with pytest.raises(CanopenError, match=r"two devices\? SDO requests are answered twice"):
        desk.run(read)


def segments(request: bytes) -> list[bytes]:
    """An upload that does not end."""
    if request[0] & 0xE0 == 0x40:
        return [b"\x40" + request[1:4] + bytes(4)]
    return [bytes((request[0] & 0x10,)) + b"endless"] if request[0] & 0xE0 == 0x60 else []


def test_endless_upload_is_aborted(desk: Site) -> None:
    desk.client.longest_upload_ns = 50 * MS
    desk.script = segments
    with pytest.raises(SdoCommunicationError, match="6083h/0 is too long to be read"):
        desk.read()
    site.pass_time(MS)
    assert desk.requests[-1][:1] == ABORTED
    desk.script = lambda _: [VALUE + ADDRESS + b"\x05\0\0\0"]
    assert desk.read() == b"\x05\0\0\0"


def test_wrong_toggle_bit_aborts_the_upload(desk: Site) -> None:
    desk.script = lambda request: [b"\0" + frame[1:] if frame[0] == 0x10 else frame for frame in segments(request)]
    with pytest.raises(SdoCommunicationError):
        desk.read()
    site.pass_time(MS)
    assert desk.requests[-1][4:] == Abort.TOGGLE_NOT_ALTERNATED.to_bytes(4, "little")


@pytest.mark.parametrize("switches", [True, False])
def test_domain_is_read_by_segments_from_a_node_without_blocks(desk: Site, switches: bool) -> None:
    """The node aborts the block transfer, or continues by itself with another one."""
    variable = ODVariable("Trace", INDEX, 0)
    variable.data_type = CanType.DOMAIN.code
    desk.client.dictionary.add_object(variable)

    def script(request: bytes) -> list[bytes]:
        command = request[0] & 0xE0
        if command == 0x60:
            return [b"\x01content"]
        if command == 0x40 or (command == 0xA0 and switches):
            return [b"\x41" + ADDRESS + b"\x07\0\0\0"]
        return [ABORTED + ADDRESS + Abort.INVALID_COMMAND.to_bytes(4, "little")] if command == 0xA0 else []

    desk.script = script
    assert desk.read() == b"content"
    assert desk.requests[0][0] & 0xE3 == 0xA0


def test_question_is_answered_without_a_task(desk: Site) -> None:
    """And an access that follows it waits for its answer."""
    desk.network.loop.call_later(20 * MS, lambda: desk.send(VALUE + ADDRESS + b"\xff\xff\xff\xff"))
    desk.script = lambda request: [VALUE + OTHER + bytes(4)] if request[1:4] == OTHER else []
    found: list[int] = []
    desk.client.ask(INDEX, 0, lambda upload: found.append(desk.client.integer(upload, signed=True)))
    assert desk.read(0x6084) == bytes(4)
    assert [request[1:4] for request in desk.requests] == [ADDRESS, OTHER]
    assert found == [-1]


def test_question_without_an_answer_delays_an_access_by_one_timeout(desk: Site) -> None:
    found: list[Upload] = []
    desk.client.ask(INDEX, 0, found.append)
    desk.script = lambda request: [VALUE + OTHER + bytes(4)] if request[1:4] == OTHER else []
    begin = site.now()
    assert desk.read(0x6084) == bytes(4)
    assert TIMEOUT_NS <= site.now() - begin < 2 * TIMEOUT_NS
    desk.send(VALUE + ADDRESS + bytes(4))
    site.pass_time(MS)
    assert found == []
