"""The drive as a value, made of its data sheet, its answers and its overlay; without a data sheet; with a family of the user."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import pytest

import pdgw
from pdgw.ds301.communication import IDENTITY_PRODUCT, IDENTITY_VENDOR
from pdgw.ds301.objects import CanType
from pdgw.dsp402.drive_type import Dsp402Error, Quantity, Turntable
from pdgw.dsp402.identification import overlay as families
from pdgw.dsp402.identification.describe import answers_of_defaults, describe, questions
from pdgw.dsp402.identification.generic import dictionary_of, discovered_dictionary, generic_dictionary
from pdgw.dsp402.identification.overlay import NO_CHOICE, overlay, overlays, own_family, parse_overlay
from pdgw.dsp402.modes import STANDARD_HOMING_METHODS, Mode
from pdgw.dsp402.objects import DRIVE_OBJECTS, SUPPORTED_DRIVE_MODES, SUPPORTED_HOMING_METHODS
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.configuration.file import config_text, load_config, parse_config
from pdgw.peers.drive.objects import DRIVE_FAULTS, HOMING_METHODS, OBJECTS, PRODUCT_CODE, VENDOR_ID, drive_objects
from tests.support.cli import pdgw as command
from tests.support.drives.drive_types import REFERENCE_OBJECTS, References, engel, engel_dictionary

MINIMAL = 'title = "a"\nsources = ["b"]\n'
OBJECT = 'objects = {{ error_code = {{ address = "{}", name = "Error", type = "{}" }} }}'


def test_the_engel_drive_is_its_data_sheet_and_its_overlay() -> None:
    drive = engel()
    assert drive.family == "engel"
    for entry in OBJECTS.entries:
        if entry.attribute:
            found = drive.entry(entry.attribute)
            assert (found.index, found.subindex, found.type, found.pdo) == (
                entry.index,
                entry.subindex,
                entry.type,
                entry.pdo,
            )
            assert found.limits == entry.limits
    assert dict(drive.homing_methods) == HOMING_METHODS
    assert dict(drive.faults) == dict(DRIVE_FAULTS)
    assert {*drive.modes} == {-5, -4, -3, 1, 3, 4, 6}
    assert (drive.speed_mode, drive.require_profile_position()) == (Mode.VELOCITY, Mode.POSITION)
    assert drive.quirks.turntable == Turntable(-5, 0x0800, 0x1000)
    assert drive.fault_of_code[0x7305].number == 5


def test_the_engel_drive_has_five_mappable_pdos_of_each_direction() -> None:
    pdos = engel().pdos
    assert [slot.number for slot in pdos.rpdos] == [slot.number for slot in pdos.tpdos] == [1, 2, 3, 4, 5]
    assert pdos.tpdos[0].cob_id == 0x181
    assert pdos.tpdos[0].mapping == (0x60410010, 0x606C0020)
    assert pdos.tpdos[0].mapping_writable
    assert pdos.tpdos[0].event_timer
    assert not pdos.rpdos[0].event_timer
    assert DRIVE_OBJECTS.attribute("target_velocity").address in pdos.mappable
    assert DRIVE_OBJECTS.entry(0x6080).address not in pdos.mappable


def test_drive_without_overlay_is_described_by_its_answers() -> None:
    answers = {
        IDENTITY_VENDOR: 0x1234_5678,
        (SUPPORTED_DRIVE_MODES, 0): 1 << 8 | 1 << 7,
        (SUPPORTED_HOMING_METHODS, 1): 37,
    }
    drive = describe(engel_dictionary(), answers)
    assert drive.family == ""
    assert drive.speed_mode == Mode.CYCLIC_VELOCITY
    assert {*drive.homing_methods} == {37}
    assert not drive.has("dynamic_speed_limit")
    with pytest.raises(Dsp402Error, match="dynamic_speed_limit"):
        drive.limits("dynamic_speed_limit")


@pytest.mark.parametrize("answers", [{}, {(SUPPORTED_DRIVE_MODES, 0): 0}], ids=["missing", "zero"])
def test_without_modes_in_6502h_they_follow_from_the_objects(answers: dict[tuple[int, int], int]) -> None:
    drive = describe(engel_dictionary(), {IDENTITY_VENDOR: 1} | answers)
    assert {*drive.modes} == {Mode.POSITION, Mode.VELOCITY, Mode.TORQUE, Mode.HOMING}
    assert {*drive.homing_methods} == {*STANDARD_HOMING_METHODS}


def test_the_device_is_asked_only_for_what_its_data_sheet_has() -> None:
    asked = questions(engel_dictionary())
    assert asked[:3] == (IDENTITY_VENDOR, IDENTITY_PRODUCT, (SUPPORTED_DRIVE_MODES, 0))
    optional = {(index, 0) for index in (0x606B, 0x6078, 0x6081, 0x6084, 0x60FD)}
    assert {*asked[3:]} == {(index, subindex) for _, index, subindex in REFERENCE_OBJECTS} | optional | {(0x6067, 0)}


def test_an_optional_object_the_device_does_not_answer_is_missing() -> None:
    drive = engel()
    answers = answers_of_defaults(engel_dictionary())
    del answers[0x606B, 0]
    assert drive.has("velocity_demand")
    assert not describe(engel_dictionary(), answers).has("velocity_demand")


@pytest.mark.parametrize(
    ("index", "declared", "found"),
    [
        (0x6064, CanType.U32, CanType.I32),
        (0x6081, CanType.I32, CanType.U32),
        (0x606C, CanType.U16, CanType.I16),
        (0x6078, CanType.I32, None),
        (0x60FF, CanType.REAL32, None),
        (0x6061, CanType.BOOLEAN, None),
    ],
    ids=["unsigned", "signed", "shorter", "longer", "a real number", "no number"],
)
def test_value_has_the_profiles_sign_or_is_missing_if_out_of_range(
    index: int, declared: CanType, found: CanType | None
) -> None:
    dictionary = copy.deepcopy(engel_dictionary())
    dictionary[index].data_type = declared.code
    drive = describe(dictionary, {IDENTITY_VENDOR: 0, (index, 0): 0})
    assert [entry.type for entry in drive.entries.values() if entry.index == index] == ([found] if found else [])


def test_limits_of_a_data_sheet_do_not_go_beyond_the_type() -> None:
    dictionary = copy.deepcopy(engel_dictionary())
    dictionary[0x6081].data_type = CanType.I32.code
    dictionary[0x6081].min, dictionary[0x6081].max = -5000, 5000
    assert describe(dictionary, {IDENTITY_VENDOR: 0, (0x6081, 0): 0}).limits("profile_velocity") == (0, 5000)


@pytest.mark.parametrize(("low", "high"), [(None, -1), (100, 5000)])
def test_range_of_a_speed_that_forbids_0_is_none(low: int | None, high: int) -> None:
    """FFFFFFFFh as the high limit of a signed number is -1: it made the setpoint 0 a slow motion."""
    dictionary = copy.deepcopy(engel_dictionary())
    dictionary[0x60FF].min, dictionary[0x60FF].max = low, high
    drive = describe(dictionary, {IDENTITY_VENDOR: 0})
    assert drive.limits("target_velocity") == CanType.I32.integer_range
    assert [text.partition(":")[0] for text in drive.ignored_ranges] == ["60FFh"]
    dictionary[0x607A].min, dictionary[0x607A].max = 100, 5000
    assert describe(dictionary, {IDENTITY_VENDOR: 0}).limits("target_position") == (100, 5000)


def test_scaling_of_the_reference_objects() -> None:
    scaling = engel().scaling
    assert [scaling.reference(quantity) for quantity in Quantity] == [6000, 6000, 1000, 1000, 500_000]
    assert scaling.rated_speed_rpm == 3000
    assert scaling.position_range == (-500_000, 500_000)
    third = engel(replace(References(), velocity_numerator=3)).scaling
    assert third.reference(Quantity.SPEED) == Fraction(2000)


def test_only_objects_needed_by_a_telegram_are_reported_missing() -> None:
    scaling = engel(replace(References(), position_max=0)).scaling
    assert scaling.refusal(Quantity.SPEED) == ""
    assert "607Bh" in scaling.refusal(Quantity.SPEED, Quantity.POSITION)
    with pytest.raises(Dsp402Error, match="position"):
        scaling.reference(Quantity.POSITION)


def test_every_overlay_of_the_package_can_be_read() -> None:
    for name, item in overlays().items():
        assert item.name == name
        assert item.sources
    found = overlay("engel").entries["analogue_input_2"]
    assert (found.index, found.subindex, found.type, found.pdo) == (0x6C01, 2, CanType.I16, True)


def test_an_overlay_is_chosen_by_the_identity() -> None:
    found = NO_CHOICE.of(0x400, 0x77)
    assert found is not None
    assert found.name == "engel"
    assert NO_CHOICE.of(0, 0) is None


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("title", "TOML"),
        ('title = "a"\nsources = []\n', "^overlay mine: sources: at least one is needed$"),
        (MINIMAL + "quirks = { boot_ms = 70000 }", "^overlay mine: quirks.boot_ms = 70000: allowed: 0 to 60000$"),
        (
            MINIMAL + "quirks = { boot_ms = 'long' }",
            "^overlay mine: quirks.boot_ms = 'long': expected an integer, allowed: 0 to",
        ),
        (MINIMAL + "titel = 'b'", "^overlay mine: titel: unknown key; did you mean title?"),
        (MINIMAL + OBJECT.format("200C", "U16"), "2003h or 6C01h/1"),
        (MINIMAL + OBJECT.format("200Ch", "WORD"), "objects.error_code.type = 'WORD': .*expected one of BOOLEAN, I8"),
        (MINIMAL + '[unit_texts]\n"rpm" = ["60FF"]', "2003h or 6C01h/1"),
        (MINIMAL + "quirks = { turntable = { mode = -1, shortest = 4, ccw = 12 } }", "shortest = 4: allowed: 11 to 15"),
        (MINIMAL + "colour = 3", "colour"),
        (MINIMAL + '[faults]\n1 = { name = "x", code = 1, error_register = 0, channel = "hot" }', "channel error type"),
    ],
)
def test_an_overlay_that_is_wrong_is_refused_with_the_key(text: str, said: str) -> None:
    with pytest.raises(Dsp402Error, match=said):
        parse_overlay("mine", text)


def test_an_unknown_family_is_refused_with_the_names_there_are() -> None:
    with pytest.raises(Dsp402Error, match="engel"):
        overlay("nobody")


# -- without a data sheet ---------------------------------------------------------------------------------------------


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


# -- families of the user ---------------------------------------------------------------------------------------------


OWN = 'title = "Mine"\nsources = ["manual"]\n[match]\nvendor_id = 0x7777\n[units]\nvelocity = "rpm"\n'
CONFIG = '[can]\ninterface = "virtual"\n[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = 1\nfamily = "./mine.toml"\n'


@pytest.fixture
def own(tmp_path: Path) -> Iterator[Path]:
    """The file of a family; one that a test adds to the process is removed again."""
    path = tmp_path / "mine.toml"
    path.write_text(OWN)
    yield path
    if families._added.pop("mine", None) is not None:
        overlays.cache_clear()


def test_an_added_family_is_found_by_name_and_identity(own: Path) -> None:
    assert NO_CHOICE.of(0x7777, 1) is None
    assert NO_CHOICE.possible(0x7777) == ()
    added = pdgw.add_family(own)
    assert overlay("mine") is added
    assert NO_CHOICE.of(0x7777, 1) is added
    assert NO_CHOICE.possible(0x7777) == (added,)
    assert pdgw.add_family(str(own)) == added


def test_the_data_sheet_of_a_family_is_beside_its_file(own: Path) -> None:
    own.write_text('eds = "mine.eds"\n' + OWN)
    assert own_family(own).eds_path == own.with_name("mine.eds")


def test_a_family_that_cannot_be_added_is_refused(own: Path) -> None:
    pdgw.add_family(own)
    own.write_text(OWN.replace("Mine", "Other"))
    with pytest.raises(Dsp402Error, match="another file name: there is a family mine already"):
        pdgw.add_family(own)
    with pytest.raises(Dsp402Error, match=r"none\.toml.*a file that can be read \(No such file"):
        pdgw.add_family(own.with_name("none.toml"))
    wrong = own.with_name("wrong.toml")
    wrong.write_text(OWN + "colour = 3")
    with pytest.raises(Dsp402Error, match=r"overlay wrong: units\.colour: unknown key"):
        pdgw.add_family(wrong)


def test_a_family_belongs_to_the_configuration_that_names_its_file(own: Path, tmp_path: Path) -> None:
    path = tmp_path / "gateway.toml"
    path.write_text(CONFIG)
    first = load_config(path)
    assert first == load_config(path)
    own.write_text(OWN.replace("Mine", "Corrected"))
    second = load_config(path)
    assert [config.families.own[0].title for config in (first, second)] == ["Mine", "Corrected"]
    assert first != second
    assert "mine" not in overlays()
    with pytest.raises(GatewayError, match=r"drive family: 'mine' is not allowed, expected .*engel"):
        parse_config(CONFIG.replace("./mine.toml", "mine"))


def test_the_family_of_an_axis_is_known_to_the_others_by_identity(own: Path, tmp_path: Path) -> None:
    path = tmp_path / "gateway.toml"
    other = "[[axis]]\ndo_id = 2\nnode_id = 2\ntelegram = 1\n"
    path.write_text(CONFIG + other)
    named, other_axis = load_config(path).axis
    for vendor_id in (0x7777, 0x400):
        found = named.families.of(vendor_id, 1)
        assert found is not None
        assert found.title == "Mine"
    assert other_axis.families.of(0x7777, 1) == named.families.of(0x7777, 1)
    assert other_axis.families.of(0x400, 1) == overlay("engel")
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "mine.toml").write_text(OWN.replace("Mine", "Other"))
    path.write_text(CONFIG + other + 'family = "b/mine.toml"\n')
    with pytest.raises(GatewayError, match=r"gateway\.toml:12: .*there is a family mine already"):
        load_config(path)


def test_the_configuration_names_the_file_of_a_family(own: Path, tmp_path: Path) -> None:
    path = tmp_path / "gateway.toml"
    path.write_text(CONFIG)
    axis = load_config(path).axis[0]
    assert axis.families.named == own_family(own)
    assert parse_config(config_text(load_config(path))).axis[0].family == str(own)
    path.write_text(CONFIG.replace("mine", "none"))
    with pytest.raises(GatewayError, match=r"gateway\.toml:7: \[\[axis\]\] number 1 family .*none\.toml.*No such file"):
        load_config(path)


def test_pdgw_drives_shows_the_family_of_a_file(own: Path) -> None:
    result = command("drives", str(own))
    assert result.returncode == 0
    assert "mine: Mine" in result.stdout
