"""PDO mappings: learned from the bus, given by telegram or EDS, changed at run time; nodes on several buses."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.ds301.configuration import map_pdo
from pdgw.ds301.objects import CanType, Entry
from pdgw.ds301.pdo import COB_ID_INVALID
from pdgw.dsp402.identification.overlay import Families, parse_overlay
from pdgw.dsp402.pdo.layouts import Operation
from pdgw.gateway.axis.telegrams import DRIVE_TELEGRAM_NUMBERS, drive_layout
from pdgw.peers.drive.objects import EDS_PATH, PRODUCT_CODE, VENDOR_ID
from pdgw.profidrive.telegrams import telegram
from pdgw.tools.decoder.capture.knowledge import dictionary_of
from pdgw.tools.decoder.frames.canopen.can_records import CanRecord, EmcyRecord, HeartbeatRecord, PdoRecord, SdoRecord
from pdgw.tools.decoder.frames.canopen.decoder import CanopenDecoder
from pdgw.tools.decoder.frames.canopen.objects import Mapped, ObjectNames, any_drive, pdo_layout
from pdgw.tools.decoder.frames.engine import CanPacket, Decoder, Settings
from pdgw.tools.decoder.frames.link import CanFrame
from pdgw.tools.decoder.frames.profinet.frame_telegrams import Axis, given_axes
from pdgw.tools.decoder.frames.records import Record
from tests.support.axis.mapping import engel_layout

NODE = 5


def feed(bus: CanopenDecoder, cob_id: int, data: bytes) -> Record:
    return bus.decode(1, 0, "can0", cob_id, data)


def write(bus: CanopenDecoder, index: int, subindex: int, data: bytes) -> None:
    """An expedited download and its confirmation."""
    unused = 4 - len(data)
    feed(bus, 0x600 + NODE, struct.pack("<BHB", 0x23 | unused << 2, index, subindex) + data.ljust(4, b"\0"))
    feed(bus, 0x580 + NODE, struct.pack("<BHB4x", 0x60, index, subindex))


def read(bus: CanopenDecoder, index: int, subindex: int, data: bytes) -> Record:
    """An expedited upload; the record of its answer."""
    feed(bus, 0x600 + NODE, struct.pack("<BHB4x", 0x40, index, subindex))
    head = struct.pack("<BHB", 0x43 | (4 - len(data)) << 2, index, subindex)
    return feed(bus, 0x580 + NODE, head + data.ljust(4, b"\0"))


def values(record: Record) -> dict[str, object]:
    assert isinstance(record, PdoRecord)
    (unit,) = record.units
    return {item.name: raw for item, raw in unit.items()}


def configure(bus: CanopenDecoder, operation: Operation) -> None:
    """What the gateway writes to a drive."""
    layout = engel_layout(operation)
    for pdo in (*layout.rpdos, *layout.tpdos):
        for step in map_pdo(pdo, pdo.cob_id(NODE)):
            write(bus, step.index, step.subindex, step.data)


@pytest.mark.parametrize("number", DRIVE_TELEGRAM_NUMBERS)
def test_every_pdo_the_gateway_maps_for_a_telegram_is_read(number: int) -> None:
    bus = CanopenDecoder([Axis(1, number, NODE)])
    layout = drive_layout(telegram(number))
    for pdo in (*layout.rpdos, *layout.tpdos):
        assert list(values(feed(bus, pdo.cob_id(NODE), bytes(pdo.size)))) == [entry.name for entry in pdo.entries]


def test_the_gateways_own_configuration_of_a_drive_is_learned() -> None:
    bus = CanopenDecoder()
    assert isinstance(feed(bus, 0x180 + NODE, bytes(6)), CanRecord)
    configure(bus, Operation.POSITIONING)
    record = feed(bus, 0x180 + NODE, struct.pack("<Hbi", 0x0237, 1, -7))
    expected = {"Statusword": 0x0237, "Modes of Operation Display": 1, "Position Actual Value": -7}
    assert values(record) == expected
    assert values(feed(bus, 0x400 + NODE, struct.pack("<II", 300, 400))) == {
        "Profile Acceleration": 300,
        "Profile Deceleration": 400,
    }
    configure(bus, Operation.VELOCITY)
    assert values(feed(bus, 0x180 + NODE, struct.pack("<Hi", 0x0237, 5))) == {
        "Statusword": 0x0237,
        "Velocity Actual Value": 5,
    }


def test_a_pdo_moves_with_its_cob_id_and_ends_when_made_invalid() -> None:
    bus = CanopenDecoder()
    configure(bus, Operation.VELOCITY)
    data = struct.pack("<Hi", 0x0237, 5)
    write(bus, 0x1800, 1, struct.pack("<I", 0x1F0))
    assert values(feed(bus, 0x1F0, data))["Velocity Actual Value"] == 5
    assert not isinstance(feed(bus, 0x180 + NODE, data), PdoRecord)
    write(bus, 0x1800, 1, struct.pack("<I", 0x1F0 | COB_ID_INVALID))
    assert not isinstance(feed(bus, 0x1F0, data), PdoRecord)
    write(bus, 0x1800, 1, struct.pack("<I", 0x1F0))
    assert values(feed(bus, 0x1F0, data))["Velocity Actual Value"] == 5


def test_a_refused_write_changes_nothing() -> None:
    bus = CanopenDecoder((Axis(1, 1, NODE),))
    data = struct.pack("<Hi", 0x0237, 5)
    feed(bus, 0x600 + NODE, struct.pack("<BHBI", 0x23, 0x1800, 1, 0x1F0))
    feed(bus, 0x580 + NODE, struct.pack("<BHBI", 0x80, 0x1800, 1, 0x06090030))
    assert isinstance(feed(bus, 0x180 + NODE, data), PdoRecord)


def test_a_configured_pdo_that_is_switched_off_comes_back() -> None:
    bus = CanopenDecoder((Axis(1, 1, NODE),), origin="configuration")
    data = struct.pack("<Hi", 0x0237, 5)
    write(bus, 0x1800, 1, struct.pack("<I", 0x180 + NODE | COB_ID_INVALID))
    assert not isinstance(feed(bus, 0x180 + NODE, data), PdoRecord)
    write(bus, 0x1800, 1, struct.pack("<I", 0x180 + NODE))
    record = feed(bus, 0x180 + NODE, data)
    assert values(record)["Statusword"] == 0x0237
    assert record.details()["mapping"] == "configuration"


def test_reading_the_mapping_back_teaches_it_as_well() -> None:
    bus = CanopenDecoder()
    for subindex, value in ((1, 0x60410010), (2, 0x606C0020), (0, 2)):
        read(bus, 0x1A00, subindex, struct.pack("<I", value))
    assert values(feed(bus, 0x180 + NODE, bytes(6))) == {"Statusword": 0, "Velocity Actual Value": 0}


def test_the_eds_gives_names_and_default_mapping() -> None:
    bus = CanopenDecoder((), DICTIONARY)
    record = feed(bus, 0x180 + NODE, struct.pack("<Hi", 0x0237, 5))
    assert values(record) == {"Statusword": 0x0237, "Velocity Actual Value": 5}
    assert record.details()["mapping"] == "EDS"
    assert record.units[0].document()["signals"]["Statusword"]["text"] == "Operation Enabled"


def test_the_gateways_layout_wins_over_the_eds_also_after_a_new_cob_id() -> None:
    bus = CanopenDecoder((Axis(1, 9, NODE),), DICTIONARY)
    data = struct.pack("<Hbi", 0x0237, 1, -7)
    assert values(feed(bus, 0x180 + NODE, data))["Position Actual Value"] == -7
    write(bus, 0x1800, 1, struct.pack("<I", 0x1F0))
    assert values(feed(bus, 0x1F0, data))["Position Actual Value"] == -7


def test_a_dcfs_values_win_over_defaults(tmp_path: Path) -> None:
    text = EDS_PATH.read_text()
    section = text.index("[1A00sub2]")
    end = text.index("\n\n", section)
    dcf = tmp_path / "drive.dcf"
    dcf.write_text(text[:end] + "\nParameterValue=0x60640020" + text[end:])
    bus = CanopenDecoder((), dictionary_of({NODE: dcf}))
    assert values(feed(bus, 0x180 + NODE, struct.pack("<Hi", 0x0237, 5))) == {
        "Statusword": 0x0237,
        "Position Actual Value": 5,
    }


def test_buses_do_not_share_their_nodes() -> None:
    decoder = Decoder(Settings((Axis(1, 1, NODE, "can0"), Axis(2, 9, NODE, "can1"))))
    velocity = decoder.decode(CanPacket(1, 0, "can0", CanFrame(0x180 + NODE, bytes(7))))
    positioning = decoder.decode(CanPacket(2, 0, "can1", CanFrame(0x180 + NODE, bytes(7))))
    other = decoder.decode(CanPacket(3, 0, "can2", CanFrame(0x180 + NODE, bytes(7))))
    assert (velocity.units[0].axis, positioning.units[0].axis) == (1, 2)
    assert "Modes of Operation Display" in values(positioning)
    assert not other.units


def test_without_node_ids_the_axis_numbers_are_used() -> None:
    decoder = Decoder(Settings(given_axes([1, 9])))
    record = decoder.decode(CanPacket(1, 0, "", CanFrame(0x202, bytes(7))))
    assert values(record) == {"Controlword": 0, "Modes of Operation": 0, "Target Position": 0}


def test_bit_fields_gaps_and_signed_parts_are_cut_out() -> None:
    names = ObjectNames([Entry(0x2100, 0, "Flag", CanType.BOOLEAN), Entry(0x2101, 0, "Small", CanType.I8)])
    mapping = [Mapped(0x2100, 0, 1), Mapped(0x0005, 0, 3), Mapped(0x2101, 0, 4), Mapped(0x2102, 1, 24)]
    layout = pdo_layout("TPDO1", NODE, 1, mapping, names, "test")
    assert layout is not None
    assert [item.name for item in layout.unit.fields] == ["Flag", "Small", "2102h.1"]
    assert layout.unpack(bytes.fromhex("F1 563412")) == (1, -1, 0x123456)


@given(
    mapped=st.lists(st.builds(Mapped, st.integers(0x20, 0xFFFF), st.integers(0, 255), st.integers(0, 80)), max_size=9),
    data=st.binary(min_size=8, max_size=8),
)
def test_any_mapping_is_a_layout_or_none(mapped: list[Mapped], data: bytes) -> None:
    layout = pdo_layout("TPDO1", NODE, 1, mapped, any_drive(), "test")
    bits = sum(item.bits for item in mapped)
    possible = mapped and bits <= 64 and all(item.bits for item in mapped)
    assert (layout is not None) == bool(possible)
    if layout is not None:
        assert len(layout.unpack(data)) == len(mapped)


def test_heartbeat_states_and_boot_up() -> None:
    bus = CanopenDecoder()
    records = [feed(bus, 0x700 + NODE, bytes((state,))) for state in (0, 127, 5, 5, 4, 0x42)]
    assert all(isinstance(record, HeartbeatRecord) for record in records)
    assert [record.summary for record in records] == [
        "boot-up",
        "boot-up -> pre-operational",
        "pre-operational -> operational",
        "operational",
        "operational -> stopped",
        "stopped -> state 42h",
    ]


def test_emcy_and_abort_are_shown_as_text() -> None:
    bus = CanopenDecoder()
    emcy = feed(bus, 0x80 + NODE, bytes.fromhex("3081110000000000"))
    assert isinstance(emcy, EmcyRecord)
    assert (emcy.code, emcy.register, emcy.node) == (0x8130, 0x11, NODE)
    assert emcy.summary == "8130h life guard or heartbeat error (drive: CANopen), register 11h: generic, communication"
    abort = feed(bus, 0x580 + NODE, bytes.fromhex("8040600030000906"))
    assert isinstance(abort, SdoRecord)
    assert abort.abort == 0x06090030
    assert "6040h.0 Controlword 0609 0030h: value range of parameter exceeded" in abort.summary


def test_shortened_request_is_shown_with_its_content() -> None:
    """Typed by hand (cansend 601#2B4060000600); most drives take it. A drive's own frames are never short."""
    bus = CanopenDecoder()
    write_short = feed(bus, 0x600 + NODE, bytes.fromhex("2B4060000600"))
    assert isinstance(write_short, SdoRecord)
    assert (write_short.index, write_short.value) == (0x6040, b"\x06\x00")
    assert write_short.summary.endswith("= 0006h [Shutdown] (SDO frame of 6 bytes, expected 8)")
    assert feed(bus, 0x600 + NODE, bytes.fromhex("2B4060")).summary == "SDO frame of 3 bytes, expected 8"
    assert feed(bus, 0x580 + NODE, bytes.fromhex("60406000")).summary == "SDO frame of 4 bytes, expected 8"


def test_an_encoder_is_known_by_its_device_type_and_telegram() -> None:
    bus = CanopenDecoder()
    read(bus, 0x1000, 0, struct.pack("<I", 0x00020196))
    for subindex, value in ((1, 0x60040020), (0, 1)):
        write(bus, 0x1A00, subindex, struct.pack("<I", value))
    assert values(feed(bus, 0x180 + NODE, struct.pack("<I", 1234))) == {"Position value": 1234}
    assert (
        "6502h.0 Number of distinguishable revolutions"
        in feed(CanopenDecoder((Axis(1, 82, NODE),)), 0x600 + NODE, struct.pack("<BHB4x", 0x40, 0x6502, 0)).summary
    )


COB_IDS = [function | node for function in range(0, 0x800, 0x80) for node in (0, NODE, NODE + 1)]
DICTIONARY = dictionary_of({}, EDS_PATH)


@given(frames=st.lists(st.tuples(st.sampled_from(COB_IDS), st.binary(max_size=8)), max_size=40))
def test_any_frames_are_records_with_documents(frames: list[tuple[int, bytes]]) -> None:
    bus = CanopenDecoder((Axis(1, 9, NODE),), DICTIONARY)
    for cob_id, data in frames:
        record = feed(bus, cob_id, data)
        assert record.document()["bus"] == "can"
        assert record.data == data


@pytest.mark.parametrize(
    ("raw", "shown"),
    [
        (0x03, "3 [velocity]"),
        (0xFB, "-5 [turntable]"),
        (0xFD, "-3 [speed control with dynamic current limitation or current]"),
        (0x9C, "-100"),
    ],
)
def test_a_mode_of_an_unknown_drive_has_the_names_of_every_family_that_has_its_number(raw: int, shown: str) -> None:
    assert any_drive().text(0x6061, 0, bytes((raw,))) == shown


def identify(bus: CanopenDecoder, vendor_id: int, product_code: int, name: bytes = b"") -> None:
    """What a gateway reads of a drive at its start."""
    found = [(0x1000, 0, (402).to_bytes(4, "little")), (0x1018, 1, vendor_id.to_bytes(4, "little"))]
    found.append((0x1018, 2, product_code.to_bytes(4, "little")))
    found += [(0x1008, 0, name)] if name else []
    for index, subindex, data in found:
        read(bus, index, subindex, data)


MAXON = 0xFB
TEXTS = (
    (0x2003, b"\1\0", "Dynamic Speed Limit", "0.5 rpm"),
    (0x60FF, b"\1\0\0\0", "Target Velocity", "velocity units (6094h rpm)"),
    (0x607A, b"\1\0\0\0", "Target Position", "increments (1000h per revolution)"),
)


@pytest.mark.parametrize(("index", "data", "name", "unit"), TEXTS)
def test_objects_and_units_of_a_family_are_shown_only_for_its_drives(
    index: int, data: bytes, name: str, unit: str
) -> None:
    unknown, engel, other = CanopenDecoder(), CanopenDecoder(), CanopenDecoder()
    identify(engel, VENDOR_ID, PRODUCT_CODE)
    identify(other, MAXON, 1)
    for bus, own in ((unknown, True), (engel, True), (other, False)):
        write(bus, index, 0, data)
        text = read(bus, index, 0, data).summary
        assert (unit in text) is own
        assert (name in text) is (own or index >= 0x6000)


def test_a_family_of_the_user_is_known_to_a_decoder_that_is_given_it() -> None:
    text = 'title = "Mine"\nsources = ["manual"]\n[match]\nvendor_id = 0x7777\n[modes]\n-5 = "winding"\n'
    with_own, without = CanopenDecoder(families=Families((parse_overlay("mine", text),))), CanopenDecoder()
    for bus in (with_own, without):
        identify(bus, 0x7777, 1)
    shown = [read(bus, 0x6061, 0, struct.pack("b", -5)).summary for bus in (with_own, without)]
    assert ["winding" in text for text in shown] == [True, False]


def test_bits_of_the_controlword_are_those_of_the_drive_s_family() -> None:
    bits = {}
    for vendor in (VENDOR_ID, MAXON):
        bus = CanopenDecoder([Axis(1, 1, NODE)])
        identify(bus, vendor, PRODUCT_CODE)
        record = feed(bus, 0x200 + NODE, bytes.fromhex("00000000 0F18"))
        bits[vendor] = next(field.bits for field in record.units[0].layout.fields if field.name == "Controlword")
    names = {vendor: {bit.name for bit in found} for vendor, found in bits.items()}
    assert names[VENDOR_ID] - names[MAXON] == {"TURNTABLE_SHORTEST", "TURNTABLE_CCW"}
    assert names[MAXON] < names[VENDOR_ID]


@pytest.mark.parametrize(
    ("vendor", "name", "shown"),
    [
        (VENDOR_ID, b"", "-3 [speed control with dynamic current limitation]"),
        (MAXON, b"EPOS", "-3"),
        (MAXON, b"EPOS2", "-3 [current]"),
        (0x1234, b"", "-3"),
    ],
)
def test_a_mode_of_a_manufacturer_has_the_name_its_family_gives_it(vendor: int, name: bytes, shown: str) -> None:
    bus = CanopenDecoder()
    identify(bus, vendor, PRODUCT_CODE, name[:4])
    if len(name) > 4:
        _segmented(bus, name)
    assert f"= {shown} after" in read(bus, 0x6061, 0, struct.pack("b", -3)).summary


def _segmented(bus: CanopenDecoder, name: bytes) -> None:
    """1008h of more than four characters."""
    feed(bus, 0x600 + NODE, struct.pack("<BHB4x", 0x40, 0x1008, 0))
    feed(bus, 0x580 + NODE, struct.pack("<BHBI", 0x41, 0x1008, 0, len(name)))
    feed(bus, 0x600 + NODE, bytes((0x60,)) + bytes(7))
    feed(bus, 0x580 + NODE, bytes((1 | (7 - len(name)) << 1,)) + name.ljust(7, b"\0"))


def test_an_error_code_has_the_manufacturer_s_name_for_drives_of_its_family_only() -> None:
    told = {}
    for vendor in (VENDOR_ID, MAXON):
        bus = CanopenDecoder()
        identify(bus, vendor, PRODUCT_CODE)
        told[vendor] = feed(bus, 0x80 + NODE, bytes.fromhex("0573 21 0000000000")).summary
    assert "(drive: motor feedback)" in told[VENDOR_ID]
    assert "drive:" not in told[MAXON]
