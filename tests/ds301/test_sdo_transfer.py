"""Client and server of SDO transfers against those of canopen, and against each other when frames are lost."""

from __future__ import annotations

from binascii import crc_hqx
from collections.abc import Callable
from random import Random

import canopen
import pytest
from canopen.sdo import SdoClient
from canopen.sdo import SdoServer as CanopenServer
from hypothesis import given
from hypothesis import strategies as st

from pdgw.ds301.aborts import Abort, SdoAbortedError
from pdgw.ds301.sdo_frames import FRAME_SIZE
from pdgw.ds301.sdo_transfer import Download, SdoServer, Transfer, Upload

INDEX, SUBINDEX = 0x2100, 3
ADDRESS = b"\x00\x21\x03"
TIMEOUT = 100
BLOCK = 127 * 7
SIZES = [1, 2, 3, 4, 5, 6, 7, 8, 13, 14, 15, 100, BLOCK - 1, BLOCK, BLOCK + 1, 2 * BLOCK, 2000]
Answer = Callable[[bytes], list[bytes]]


def content(size: int) -> bytes:
    return bytes(n * 7 & 0xFF for n in range(size))


class Objects:
    """One object, as servers of both kinds need it."""

    def __init__(self, data: bytes = b"") -> None:
        self.data = data
        self.object_dictionary = canopen.ObjectDictionary()

    def get_data(self, index: int, subindex: int, check_readable: bool = False) -> bytes:
        if (index, subindex) != (INDEX, SUBINDEX):
            raise SdoAbortedError(Abort.NO_SUCH_OBJECT)
        return self.data

    def set_data(self, index: int, subindex: int, data: bytes, check_writable: bool = False) -> None:
        self.get_data(index, subindex)
        self.data = bytes(data)


def server_of(objects: Objects) -> Answer:
    return SdoServer(objects).answer


def canopen_server_of(objects: Objects) -> Answer:
    server = CanopenServer(0x601, 0x581, objects)
    sent: list[bytes] = []
    server.send_response = lambda frame: sent.append(bytes(frame))

    def answer(frame: bytes) -> list[bytes]:
        sent.clear()
        server.on_request(0x601, bytearray(frame), 0.0)
        return sent.copy()

    return answer


def canopen_client_of(answer: Answer) -> SdoClient:
    client = SdoClient(0x601, 0x581, canopen.ObjectDictionary())
    client.RESPONSE_TIMEOUT = 0.01

    def send(frame: bytes) -> None:
        for each in answer(bytes(frame)):
            client.on_response(0x581, bytearray(each), 0.0)

    client.send_request = send
    return client


def carry_out(transfer: Transfer, answer: Answer, loses: Callable[[], bool] = lambda: False) -> None:
    """A whole transfer with a server; ``loses``: whether the next frame of the server is lost."""
    now = 0
    transfer.begin(now)
    frames = [transfer.request]
    while frames:
        assert {len(frame) for frame in frames} == {FRAME_SIZE}
        answers = [each for frame in frames for each in answer(frame)]
        frames = [frame for each in answers if not loses() for frame in transfer.take(each, now)]
        if not frames and not transfer.ended:
            now += TIMEOUT
            frames = transfer.check(now)


@pytest.mark.parametrize("size", SIZES)
def test_client_reads_and_writes_every_size_with_the_server_of_canopen(size: int) -> None:
    objects = Objects(content(size))
    answer = canopen_server_of(objects)
    upload = Upload(INDEX, SUBINDEX, TIMEOUT)
    carry_out(upload, answer)
    assert (bytes(upload.sink.data), upload.code, upload.failure) == (content(size), None, "")
    download = Download(INDEX, SUBINDEX, content(size)[::-1], TIMEOUT)
    carry_out(download, answer)
    assert (objects.data, download.code, download.failure) == (content(size)[::-1], None, "")


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("by_blocks", [False, True])
def test_server_serves_every_size_to_the_client_of_canopen(size: int, by_blocks: bool) -> None:
    objects = Objects(content(size))
    client = canopen_client_of(server_of(objects))
    with client.open(INDEX, SUBINDEX, "rb", buffering=0, block_transfer=by_blocks) as stream:
        assert stream.size == size
        assert b"".join(iter(lambda: stream.read(7), b"")) == content(size)
    with client.open(INDEX, SUBINDEX, "wb", buffering=7, size=size, block_transfer=by_blocks) as stream:
        stream.write(content(size)[::-1])
    assert objects.data == content(size)[::-1]
    client.download(INDEX, SUBINDEX, content(size), force_segment=True)
    assert objects.data == content(size)


@given(size=st.integers(1, 2500), seed=st.integers(0, 1000))
def test_blocks_with_lost_segments_are_complete_or_aborted(size: int, seed: int) -> None:
    """Each twentieth frame of the server is lost."""
    chance = Random(seed)
    objects = Objects(content(size))
    upload = Upload(INDEX, SUBINDEX, TIMEOUT, by_blocks=True)
    carry_out(upload, server_of(objects), lambda: chance.random() < 0.05)
    assert upload.failure or bytes(upload.sink.data) == content(size)


def test_block_whose_last_segments_are_lost_is_requested_again() -> None:
    lost = iter([False] * 100 + [True] * 40)
    upload = Upload(INDEX, SUBINDEX, TIMEOUT, by_blocks=True)
    carry_out(upload, server_of(Objects(content(2000))), lambda: next(lost, False))
    assert (bytes(upload.sink.data), upload.failure) == (content(2000), "")


@pytest.mark.parametrize("size", [0, *SIZES])
def test_client_writes_every_size(size: int) -> None:
    objects = Objects(b"old")
    download = Download(INDEX, SUBINDEX, content(size), TIMEOUT)
    carry_out(download, server_of(objects))
    assert (objects.data, download.code, download.failure) == (content(size), None, "")


@pytest.mark.parametrize("by_blocks", [False, True])
def test_abort_of_the_server_ends_an_access(by_blocks: bool) -> None:
    answer = server_of(Objects(b"data of an object"))
    for transfer in (
        Upload(0x3000, 0, TIMEOUT, by_blocks=by_blocks),
        Download(0x3000, 0, b"x", TIMEOUT),
    ):
        carry_out(transfer, answer)
        assert transfer.ended
        assert transfer.code == Abort.NO_SUCH_OBJECT


@pytest.mark.parametrize(
    ("requests", "abort"),
    [
        ([b"\x60"], Abort.INVALID_COMMAND),
        ([b"\x00abc"], Abort.INVALID_COMMAND),
        ([b"\xa3"], Abort.INVALID_COMMAND),
        ([b"\xe0"], Abort.INVALID_COMMAND),
        ([b"\xa4" + ADDRESS, b"\xa3"], Abort.INVALID_BLOCK_SIZE),
        ([b"\xa4" + ADDRESS + b"\x04", b"\xa3", b"\xa2\x09\x04"], Abort.INVALID_SEQUENCE_NUMBER),
        ([b"\xa4" + ADDRESS + b"\x04", b"\xa3", b"\xa2\x01\x00"], Abort.INVALID_BLOCK_SIZE),
        ([b"\x40" + ADDRESS, b"\x70"], Abort.TOGGLE_NOT_ALTERNATED),
        ([b"\x21" + ADDRESS, b"\x10abc"], Abort.TOGGLE_NOT_ALTERNATED),
        ([b"\x21" + ADDRESS, b"\x0dx", b"\x0dx"], Abort.INVALID_COMMAND),
        ([b"\xc4" + ADDRESS, b"\x81content", b"\xc1\x01\x02"], Abort.CRC_ERROR),
        ([b"\xc4" + ADDRESS, b"\x81content", b"\x01content"], Abort.INVALID_COMMAND),
        ([b"\x40\x00\x30\x00"], Abort.NO_SUCH_OBJECT),
        ([b"\x40" + ADDRESS, b"\x80" + ADDRESS, b"\x60"], Abort.INVALID_COMMAND),
    ],
)
def test_server_aborts_invalid_requests(requests: list[bytes], abort: Abort) -> None:
    answer = server_of(Objects(content(40)))
    for request in requests:
        last = answer(request.ljust(8, b"\0"))
    assert last[-1][0] == 0x80
    assert int.from_bytes(last[-1][4:], "little") == abort


def test_frames_of_a_block_upload_are_those_of_the_standard() -> None:
    data, answer = content(40), server_of(Objects(content(40)))
    requests = [b"\xa4" + ADDRESS + b"\x04", b"\xa3", b"\xa2\x02\x04", b"\xa2\x04\x04", b"\xa1"]
    answers = [frame for request in requests for frame in answer(request.ljust(8, b"\0"))]
    assert answers[0] == b"\xc6" + ADDRESS + b"\x28\0\0\0"
    assert [frame[0] for frame in answers[1:5]] == [1, 2, 3, 4]
    # Two of four were confirmed: the third is sent again as the first of the next block.
    assert [frame[0] for frame in answers[5:9]] == [1, 2, 3, 0x84]
    assert b"".join(frame[1:] for frame in (*answers[1:3], *answers[5:9]))[:40] == data
    assert answers[9:] == [b"\xc9" + crc_hqx(data, 0).to_bytes(2, "little") + bytes(5)]


def test_server_without_data_aborts() -> None:
    (abort,) = server_of(Objects())(b"\x40" + ADDRESS + bytes(4))
    assert abort == b"\x80" + ADDRESS + Abort.NO_DATA.to_bytes(4, "little")


@pytest.mark.parametrize("by_blocks", [False, True])
def test_upload_ends_at_its_limits(by_blocks: bool) -> None:
    upload = Upload(INDEX, SUBINDEX, TIMEOUT, by_blocks=by_blocks, limit=100)
    carry_out(upload, server_of(Objects(content(2000))))
    assert upload.failure == " is too long to be read"
    slow = Upload(INDEX, SUBINDEX, TIMEOUT, limit_ns=3 * TIMEOUT)
    slow.begin(0)
    slow.take(b"\x40" + ADDRESS + bytes(4), 0)
    for number in range(1, 4):
        slow.take(bytes((0x10 * (number & 1 ^ 1),)) + b"endless", 80 * number)
        assert slow.check(80 * number) == []
    assert slow.due == 3 * TIMEOUT
    (abort,) = slow.check(slow.due)
    assert (abort[0], slow.failure) == (0x80, " is too long to be read")


@given(frames=st.lists(st.binary(min_size=8, max_size=8), max_size=30), by_blocks=st.booleans())
def test_no_frame_ends_a_client_or_a_server_with_an_error(frames: list[bytes], by_blocks: bool) -> None:
    answer = server_of(Objects(content(40)))
    transfers: list[Transfer] = [
        Upload(INDEX, SUBINDEX, TIMEOUT, by_blocks=by_blocks),
        Download(INDEX, SUBINDEX, content(40), TIMEOUT),
    ]
    for frame in frames:
        for each in (frame, frame[:1] + ADDRESS + frame[4:]):
            answer(each)
            for transfer in transfers:
                if not transfer.ended:
                    transfer.take(each, 0)
