"""The CANopen node without a device profile, under canopen's own SDO client."""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace

import canopen
import pytest
from canopen.sdo import SdoClient

from pdgw.base.durations import MS
from pdgw.ds301.aborts import Abort
from pdgw.ds301.communication import NmtState, communication_objects, pdo_objects
from pdgw.ds301.eds.writer import DeviceInfo, write_eds
from pdgw.ds301.objects import Access, CanType, ObjectSpec, var
from pdgw.peers.node.node import SimulatedNode

NODE = 9
NAME = "A device name longer than one segment of seven bytes"
OBJECTS: tuple[ObjectSpec, ...] = (
    *communication_objects(0, NAME, (1, 2, 3, 4), ("1", "2")),
    *pdo_objects(1, 1, ()),
    var(0x2000, "Secret", CanType.U16, Access.WO),
    var(0x2001, "Level", CanType.I16, default=-5, low=-10, high=10),
    var(0x2002, "Ratio", CanType.REAL32, default=0.5),
)


class _Desk:
    """A node and canopen's SDO client joined without bus or thread."""

    def __init__(self) -> None:
        self.frames: list[tuple[int, bytes]] = []
        self.node = SimulatedNode(NODE, OBJECTS, SimpleNamespace(error_register=0), self._sent)
        self.sdo = SdoClient(0x600 + NODE, 0x580 + NODE, canopen.ObjectDictionary())
        self.sdo.network = self
        self.sdo.RESPONSE_TIMEOUT = 0.01
        self.node.start(0)

    def _sent(self, can_id: int, data: bytes) -> None:
        self.frames.append((can_id, data))
        if can_id == 0x580 + NODE:
            self.sdo.on_response(can_id, bytearray(data), 0.0)

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self.node.receive(can_id, bytes(data), self.node.now)


@pytest.fixture
def desk() -> _Desk:
    return _Desk()


def test_segmented_and_expedited_transfers(desk: _Desk) -> None:
    assert desk.sdo.upload(0x1008, 0) == NAME.encode()
    assert desk.sdo.upload(0x2001, 0) == (-5).to_bytes(2, "little", signed=True)
    desk.sdo.download(0x2001, 0, b"\x07\x00", force_segment=True)
    assert desk.node.read(0x2001) == 7
    desk.sdo.download(0x2002, 0, b"\0\0\xc0?")
    assert desk.node.read(0x2002) == 1.5


def test_block_transfers(desk: _Desk) -> None:
    with desk.sdo.open(0x1008, 0, "rb", buffering=0, block_transfer=True) as stream:
        assert b"".join(iter(lambda: stream.read(7), b"")) == NAME.encode()
    with desk.sdo.open(0x2001, 0, "wb", buffering=7, size=2, block_transfer=True) as stream:
        stream.write(b"\x07\x00")
    assert desk.node.read(0x2001) == 7


@pytest.mark.parametrize(
    ("index", "subindex", "data", "abort"),
    [
        (0x2000, 0, None, Abort.WRITE_ONLY),
        (0x3000, 0, None, Abort.NO_SUCH_OBJECT),
        (0x1018, 9, None, Abort.NO_SUCH_SUBINDEX),
        (0x1003, 1, None, Abort.NO_DATA),
        (0x1008, 0, b"other", Abort.READ_ONLY),
        (0x2001, 0, b"\x0b\0", Abort.VALUE_TOO_HIGH),
        (0x2001, 0, b"\xf5\xff", Abort.VALUE_TOO_LOW),
        (0x2001, 0, b"\0" * 20, Abort.LENGTH_TOO_HIGH),
        (0x1011, 1, b"save", Abort.CANNOT_STORE),
    ],
)
def test_refusals_carry_the_abort_code(
    desk: _Desk, index: int, subindex: int, data: bytes | None, abort: Abort
) -> None:
    transfer = desk.sdo.upload if data is None else partial(desk.sdo.download, data=data)
    with pytest.raises(canopen.SdoAbortedError) as refused:
        transfer(index, subindex)
    assert refused.value.code == abort


def test_nmt_states_and_services_of_a_stopped_node(desk: _Desk) -> None:
    assert desk.frames == [(0x700 + NODE, b"\0")]
    for command, state in ((1, NmtState.OPERATIONAL), (2, NmtState.STOPPED), (128, NmtState.PRE_OPERATIONAL)):
        for target in (0, NODE):
            desk.node.receive(0, bytes((command, target)), 0)
            assert desk.node.state is state
        desk.node.receive(0, bytes((1, NODE + 1)), 0)
        assert desk.node.state is state, "for another node"
    desk.node.receive(0, bytes((2, 0)), 0)
    desk.frames.clear()
    with pytest.raises(canopen.SdoCommunicationError):
        desk.sdo.upload(0x1000, 0)
    desk.node.send_emcy(0x1000, 1)
    assert desk.frames == [], "no SDO, no EMCY in STOPPED"
    desk.node.receive(0, bytes((130, 0)), 0)
    assert desk.frames == [(0x700 + NODE, b"\0")]
    assert desk.node.state is NmtState.PRE_OPERATIONAL


@pytest.mark.parametrize("data", [b"", b"\x01", b"\x63\x09", b"\xff\x00"])
def test_nmt_frames_without_meaning_change_nothing(desk: _Desk, data: bytes) -> None:
    desk.node.receive(0, data, 0)
    assert desk.node.state is NmtState.PRE_OPERATIONAL


def test_guarding_begins_with_the_first_heartbeat_and_expires_once() -> None:
    expired: list[int] = []
    desk = _Desk()
    desk.node.on_consumer_expired = expired.append  # type: ignore[method-assign]
    desk.sdo.download(0x1016, 1, (127 << 16 | 100).to_bytes(4, "little"))
    desk.node.poll(1000 * MS)
    assert expired == []
    desk.node.receive(0x77F, b"\x05", 1000 * MS)
    desk.node.poll(1100 * MS)
    assert expired == []
    for now in (1101, 1500, 2000):
        desk.node.poll(now * MS)
    assert expired == [127]
    desk.node.receive(0x77F, b"\x05", 2000 * MS)
    desk.node.poll(2200 * MS)
    assert expired == [127, 127]


def test_a_node_without_power_is_silent(desk: _Desk) -> None:
    desk.sdo.download(0x1017, 0, b"\x0a\0")
    desk.node.power_off()
    desk.frames.clear()
    for can_id in (0, 0x80, 0x200 + NODE, 0x600 + NODE):
        desk.node.receive(can_id, bytes((1, 0, 0, 0, 0, 0, 0, 0)), MS)
    desk.node.poll(50 * MS)
    assert desk.frames == []


def test_eds_names_relative_cob_ids_and_every_entry() -> None:
    text = write_eds(DeviceInfo("Maker", "Thing", 1, 2, 3), OBJECTS)
    assert "DefaultValue=$NODEID+0x80000180" in text
    assert "DefaultValue=$NODEID+0x80\n" in text, "EMCY"
    lists = [line.split("=")[1] for line in text.splitlines() if line.split("=")[0].isdigit()]
    assert sorted(int(index, 16) for index in lists) == sorted(spec.index for spec in OBJECTS)
    assert "LowLimit=-10\nHighLimit=10" in text


class _Image(SimpleNamespace):
    error_register = 0
    value = 7


REMOTE: tuple[ObjectSpec, ...] = (
    *communication_objects(0, "Sensor", (1, 2, 3, 4), ("1", "2")),
    *pdo_objects(0, (1, 3), (), tpdo_types={1: 254, 3: 1}, event_timer=False),
    var(0x6000, "Value", CanType.U16, Access.RO, pdo=True, attribute="value"),
)


def test_pdos_can_be_numbered_and_have_types_and_timers_of_their_own() -> None:
    indices = {spec.index: spec for spec in REMOTE if 0x1400 <= spec.index < 0x2000}
    assert list(indices) == [0x1800, 0x1A00, 0x1802, 0x1A02]
    assert [[entry.default for entry in indices[index].entries] for index in (0x1800, 0x1802)] == [
        [3, 0x8000_0180, 254, 0],
        [3, 0x8000_0380, 1, 0],
    ]


@pytest.mark.parametrize(("cob_id", "answers"), [(0x389, 1), (0x4000_0389, 0)])
def test_a_remote_frame_is_answered_in_operation_and_if_the_cob_id_allows_it(cob_id: int, answers: int) -> None:
    frames: list[tuple[int, bytes]] = []
    node = SimulatedNode(NODE, REMOTE, _Image(), lambda *frame: frames.append(frame))
    node.start(0)
    for index, subindex, value, size in ((0x1A02, 1, 0x6000_0010, 4), (0x1A02, 0, 1, 1), (0x1802, 1, cob_id, 4)):
        node.set_data(index, subindex, value.to_bytes(size, "little"), check_writable=True)
    frames.clear()
    node.receive_remote(0x389, 1 * MS)
    assert frames == []
    node.receive(0, bytes([1, NODE]), 2 * MS)
    node.receive_remote(0x389, 3 * MS)
    node.receive_remote(0x189, 3 * MS)
    assert frames == [(0x389, b"\x07\x00")] * answers
