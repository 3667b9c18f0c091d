"""Block uploads of simulated nodes, read by canopen's client and by the node client of the gateway."""

from __future__ import annotations

from binascii import crc_hqx

import canopen
import pytest
from canopen.objectdictionary import ODVariable
from canopen.sdo import SdoServer

from pdgw.ds301.aborts import Abort
from pdgw.ds301.objects import CanType, Entry
from pdgw.ds301.sdo_transfer import SdoAbortedError
from pdgw.dsp402.drive.client import DriveClient, DriveStatus
from pdgw.dsp402.drive.settings import DriveSettings
from pdgw.dsp402.pdo.layouts import LAYOUTS, Operation
from pdgw.peers.drive import SimulatedDriveNode
from pdgw.peers.node.sdo_server import BlockSdoServer
from tests.support.gateways import site

NODE, INDEX = 5, 0x2100
SIZES = [1, 4, 6, 7, 8, 14, 127 * 7 - 1, 127 * 7, 127 * 7 + 1, 3000]


def content(size: int) -> bytes:
    return bytes(n * 7 & 0xFF for n in range(size))


def give_domain(node: SimulatedDriveNode, data: bytes) -> None:
    """An object that the drive of the package does not have."""
    node.entries[INDEX, 0] = Entry(INDEX, 0, "Trace", CanType.DOMAIN)
    node.indices.add(INDEX)
    node.values[INDEX, 0] = data


class Wire(canopen.Network):  # type: ignore[misc]
    """canopen's network with one simulated drive, which answers at once."""

    def __init__(self) -> None:
        super().__init__()
        self.drive = SimulatedDriveNode(NODE, lambda can_id, data: self.notify(can_id, bytearray(data), 0.0))
        self.drive.start(0)

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self.drive.receive(can_id, bytes(data), 0)


def test_canopen_reads_blocks_of_every_length_with_their_checksum() -> None:
    network = Wire()
    remote = network.add_node(NODE, canopen.ObjectDictionary())
    for size in SIZES:
        give_domain(network.drive, content(size))
        with remote.sdo.open(INDEX, 0, "rb", buffering=0, block_transfer=True) as stream:
            assert stream.crc_supported
            assert stream.size == size
            assert b"".join(iter(lambda stream=stream: stream.read(7), b"")) == content(size)
        assert remote.sdo.upload(INDEX, 0) == content(size), "segmented as well"


def exchange(requests: list[bytes], data: bytes) -> list[bytes]:
    """What a node answers to raw SDO requests, in virtual time."""
    answers: list[bytes] = []
    node = SimulatedDriveNode(NODE, lambda can_id, frame: answers.append(frame) if can_id == 0x580 + NODE else None)
    give_domain(node, data)
    node.start(0)
    for now, request in enumerate(requests, 1):
        node.receive(0x600 + NODE, request.ljust(8, b"\0"), now)
    return answers


INITIATE = bytes((0xA4, 0x00, 0x21, 0x00, 4, 0))


def test_the_frames_are_those_of_the_standard() -> None:
    data = content(40)
    answers = exchange([INITIATE, b"\xa3", b"\xa2\x02\x04", b"\xa2\x04\x04", b"\xa1"], data)
    assert answers[0] == bytes((0xC6, 0x00, 0x21, 0x00, 40, 0, 0, 0))
    assert [frame[0] for frame in answers[1:5]] == [1, 2, 3, 4]
    # Two of four were taken: the third comes again as the first of the next block.
    assert [frame[0] for frame in answers[5:9]] == [1, 2, 3, 0x84]
    assert b"".join(frame[1:] for frame in (*answers[1:3], *answers[5:9]))[:40] == data
    assert answers[9] == bytes((0xC1 | 2 << 2, *crc_hqx(data, 0).to_bytes(2, "little"), 0, 0, 0, 0, 0))
    assert len(answers) == 10


@pytest.mark.parametrize(
    ("requests", "abort"),
    [
        ([b"\xa3"], Abort.INVALID_COMMAND),
        ([bytes((0xA4, 0x00, 0x21, 0x00, 0, 0))], Abort.INVALID_BLOCK_SIZE),
        ([INITIATE, b"\xa3", b"\xa2\x09\x04"], Abort.INVALID_SEQUENCE_NUMBER),
        ([bytes((0xA4, 0x01, 0x21, 0x00, 4, 0))], Abort.NO_SUCH_OBJECT),
    ],
)
def test_invalid_block_upload_is_aborted(requests: list[bytes], abort: Abort) -> None:
    last = exchange(requests, content(40))[-1]
    assert last[0] == 0x80
    assert int.from_bytes(last[4:8], "little") == abort


@pytest.mark.parametrize("has_blocks", [True, False])
def test_the_client_takes_blocks_for_domains_where_the_node_has_them(
    monkeypatch: pytest.MonkeyPatch, has_blocks: bool
) -> None:
    served: list[bytes] = []
    server = BlockSdoServer
    original = server.block_upload if has_blocks else SdoServer.block_upload

    def block_upload(self: SdoServer, request: bytes) -> None:
        served.append(bytes(request))
        original(self, request)

    monkeypatch.setattr(server, "block_upload", block_upload)
    with site.guarded_network() as network:
        drive = site.drive(NODE)
        give_domain(drive.node, content(200))
        client = DriveClient(network, DriveSettings(NODE), LAYOUTS[Operation.VELOCITY], lambda _: None)
        drive.start()
        client.start()
        try:
            site.wait_for(lambda: client.status is DriveStatus.ONLINE, "online")
            variable = ODVariable("Trace", INDEX, 0)
            variable.data_type = CanType.DOMAIN.code
            client.sdo.dictionary.add_object(variable)
            assert site.result(client.submit(lambda drive: drive.sdo.read(INDEX))) == content(200)
            assert served, "a block upload was asked for"
            with pytest.raises(SdoAbortedError):
                site.result(client.submit(lambda drive: drive.sdo.read(0x2FFF)))
        finally:
            client.stop()
            drive.stop()
