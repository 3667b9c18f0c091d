"""A drive without a data sheet: its objects are found out by asking."""

from __future__ import annotations

from pdgw.dsp402.drive_type import Quantity
from pdgw.dsp402.identification.describe import describe
from pdgw.dsp402.identification.generic import dictionary_of, discovered_dictionary, generic_dictionary
from pdgw.dsp402.objects import DRIVE_OBJECTS
from pdgw.peers.drive.objects import PRODUCT_CODE, VENDOR_ID, drive_objects

NODE = 5


class Device:
    """The ENGEL-like drive as what it answers to SDO uploads; ``lacks`` are indices it does not have."""

    def __init__(self, *lacks: int, pdos: int = 5) -> None:
        self.asked: list[tuple[int, int]] = []
        self.values: dict[tuple[int, int], bytes] = {}
        for spec in drive_objects(pdos=pdos):
            for entry in spec.entries:
                if entry.index not in lacks:
                    default = entry.default
                    data = default.encode() if isinstance(default, str) else b""
                    if isinstance(default, int):
                        data = (default % (1 << entry.type.bits)).to_bytes(entry.type.bits // 8, "little")
                    self.values[entry.index, entry.subindex] = data

    def read(self, index: int, subindex: int) -> bytes | None:
        self.asked.append((index, subindex))
        return self.values.get((index, subindex))


def test_answers_of_the_device_form_its_object_dictionary() -> None:
    dictionary = discovered_dictionary(NODE, Device(0x607B, 0x60C6, pdos=2).read)
    assert 0x60FF in dictionary
    assert not {0x607B, 0x60C6, 0x60A9, 0x2003} & {*dictionary}
    assert [index for index in dictionary if 0x1400 <= index < 0x1A00] == [
        0x1400,
        0x1401,
        0x1600,
        0x1601,
        0x1800,
        0x1801,
    ]
    assert dictionary.device_information.product_name == "ENGEL HBI"
    assert dictionary.get_variable(0x1800, 1).default == 0x180
    assert dictionary.get_variable(0x1A00, 1).default == DRIVE_OBJECTS.attribute("statusword").mapping
    assert dictionary.get_variable(0x6094, 2).default == 2


def test_a_missing_pdo_is_the_last_that_is_asked_for() -> None:
    device = Device(pdos=1)
    discovered_dictionary(NODE, device.read)
    assert {index for index, _ in device.asked if 0x1400 <= index < 0x1600} == {0x1400, 0x1401}


def test_a_discovered_drive_has_modes_limits_of_its_types_and_pdos() -> None:
    drive = describe(discovered_dictionary(NODE, Device(0x6502).read), {})
    assert (drive.name, drive.family) == ("ENGEL HBI", "")
    assert drive.limits("target_velocity") == (-(1 << 31), (1 << 31) - 1)
    assert drive.speed_mode == 3
    assert len(drive.pdos.rpdos) == 5
    assert drive.pdos.rpdos[0].mapping_writable
    assert drive.pdos.tpdos[0].event_timer
    assert drive.scaling.refusal(Quantity.SPEED)


def test_the_package_s_data_sheet_is_taken_only_for_the_device_it_describes() -> None:
    device = Device()
    packaged = dictionary_of(NODE, device.read, VENDOR_ID, PRODUCT_CODE)
    assert 0x2003 in packaged
    assert device.asked == []
    assert 0x2003 not in dictionary_of(NODE, device.read, VENDOR_ID, PRODUCT_CODE + 1)
    assert 0x2003 not in dictionary_of(NODE, device.read, VENDOR_ID + 1, PRODUCT_CODE)


def test_before_any_query_every_object_of_the_profile_is_assumed() -> None:
    dictionary = generic_dictionary()
    assert {0x1400, 0x1804, 0x6040, 0x6042, 0x608F, 0x60A9, 0x60E3, 0x6502} <= {*dictionary}
    assert 0x2003 not in dictionary
