"""Data sheets of the field: what is right stays, what has one meaning is repaired and listed, the rest is refused."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import canopen
import pytest

from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.eds import importer
from pdgw.ds301.eds.importer import import_eds
from pdgw.ds301.eds.text import EdsError, Repair
from pdgw.peers.drive.objects import EDS_PATH

NODE = 5
CORPUS = Path(__file__).parent / "eds"
GOOD = CORPUS / "good.eds"
REPAIRED = sorted((CORPUS / "repaired").iterdir())


def attributes(dictionary: canopen.ObjectDictionary) -> Iterator[object]:
    """Everything canopen keeps of each object and sub-index."""
    for index in dictionary:
        item = dictionary[index]
        members = [item] if isinstance(item, canopen.objectdictionary.ODVariable) else [item[sub] for sub in item]
        yield type(item), item.name
        for member in members:
            yield {key: value for key, value in vars(member).items() if key != "parent"}


def repaired(name: str) -> dict[tuple[str, str], Repair]:
    imported = import_eds(CORPUS / "repaired" / name, NODE)
    return {(repair.section, repair.key): repair for repair in imported.repairs}


def variable(name: str, index: int, subindex: int = 0) -> Any:
    return import_eds(CORPUS / "repaired" / name, NODE).dictionary.get_variable(index, subindex)


def simple(text: str, data_type: int = 7) -> bytes:
    """A sheet with one variable 2000h that has these lines."""
    head = f"[FileInfo]\n[DeviceInfo]\n[2000]\nParameterName=x\nDataType={data_type}\nAccessType=rw\n"
    return (head + text + "\n[ManufacturerObjects]\nSupportedObjects=1\n1=0x2000\n").encode()


# -- right files ------------------------------------------------------------------------------------------------------


def test_the_packages_own_sheet_needs_no_repair_and_reads_as_canopen_reads_it() -> None:
    imported = import_eds(EDS_PATH, NODE)
    assert imported.repairs == ()
    assert list(attributes(imported.dictionary)) == list(attributes(canopen.import_od(str(EDS_PATH), NODE)))


def test_each_node_of_one_file_has_its_own_identifiers() -> None:
    for node_id in (1, NODE, 127):
        imported = import_eds(EDS_PATH, node_id)
        assert list(attributes(imported.dictionary)) == list(attributes(canopen.import_od(str(EDS_PATH), node_id)))
    first, second = (import_eds(EDS_PATH, node_id).dictionary for node_id in (1, 2))
    assert (first[0x1400][1].default, second[0x1400][1].default) == (0x201, 0x202)
    assert first[0x1400] is first["RPDO1 communication parameter"]
    assert first[0x1400].parent is first
    assert first[0x1400][1].parent is first[0x1400]


def test_a_configured_value_is_relative_to_the_node_id_too() -> None:
    content = simple("DefaultValue=1\nParameterValue=$NODEID+0x180") + b"[DeviceComissioning]\nNodeID=3\n"
    dictionaries = [import_eds(content, node_id).dictionary for node_id in (2, 9)]
    assert [(item.node_id, item[0x2000].default, item[0x2000].value) for item in dictionaries] == [
        (2, 1, 0x182),
        (9, 1, 0x189),
    ]


def test_a_right_sheet_with_compact_sub_objects_needs_no_repair() -> None:
    imported = import_eds(GOOD, NODE)
    assert imported.repairs == ()
    limits = imported.dictionary[0x6046]
    assert list(limits) == [0, 1, 2]
    assert [limits[sub].name for sub in (1, 2)] == ["Limits1", "Maximum"]
    assert [limits[sub].default for sub in (0, 1, 2)] == [2, -2, -2]
    assert (limits[1].min, limits[1].max, limits[1].pdo_mappable) == (-(1 << 31), (1 << 31) - 1, True)
    assert imported.dictionary[0x1014].default == 0x85
    assert imported.dictionary.device_information.vendor_number == 0x400


@pytest.mark.parametrize(
    ("encoding", "found"),
    [
        ("utf-8", None),
        ("utf-8-sig", "utf-8-sig"),
        ("cp1252", "cp1252"),
        ("utf-16", "utf-16"),
        ("utf-16-be", "utf-16-be"),
        ("utf-16-le", "utf-16-le"),
    ],
)
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_encodings_and_line_ends(encoding: str, found: str | None, end: str) -> None:
    text = GOOD.read_text().replace("ParameterName=Gain", "ParameterName=Verstärkung µ").replace("\n", end)
    imported = import_eds(text.encode(encoding), NODE)
    assert imported.dictionary[0x2000].name == "Verstärkung µ"
    assert [repair.found for repair in imported.repairs] == ([] if found is None else [found])


def test_bytes_no_windows_code_page_has_are_read_as_latin_1() -> None:
    data = GOOD.read_bytes().replace(b"=Gain", b"=G\x81in")
    imported = import_eds(data, NODE)
    assert Repair(87, "", "encoding", "latin-1", "utf-8") in imported.repairs
    assert imported.dictionary[0x2000].name == r"G\x81in", "a control character in Latin-1"


@pytest.mark.parametrize("path", REPAIRED, ids=lambda path: path.stem)
def test_repaired_sheet_needs_no_further_repair(path: Path) -> None:
    imported = import_eds(path, NODE)
    again = import_eds(imported.text.encode(), NODE)
    assert imported.repairs
    assert again.repairs == ()
    assert list(attributes(again.dictionary)) == list(attributes(imported.dictionary))
    canopen.RemoteNode(NODE, imported.dictionary)


# -- repairs ----------------------------------------------------------------------------------------------------------


def test_every_repair_names_the_line_it_found_the_value_in() -> None:
    for path in REPAIRED:
        lines = path.read_text().splitlines()
        for repair in import_eds(path, NODE).repairs:
            assert repair.line == 0 or repair.found in lines[repair.line - 1], repair


def test_numbers() -> None:
    repairs = repaired("numbers.eds")
    assert repairs["DeviceInfo", "VendorNumber"] == Repair(5, "DeviceInfo", "VendorNumber", "001", "1")
    assert repairs["DeviceInfo", "ProductNumber"].used == "9"
    assert repairs["DeviceInfo", "RevisionNumber"].used == str(0x10001)
    assert repairs["DeviceInfo", "NrOfRXPDO"].used == ""
    assert variable("numbers.eds", 0x1000).default is None
    signed = variable("numbers.eds", 0x2001)
    assert (signed.default, signed.min, signed.max) == (-32767, None, None)
    unsigned = variable("numbers.eds", 0x2002)
    assert (unsigned.default, unsigned.min, unsigned.max, unsigned.pdo_mappable) == (0xFFFF, None, None, True)
    assert variable("numbers.eds", 0x2003).default == 1.5
    assert (variable("numbers.eds", 0x2004).default, variable("numbers.eds", 0x2004).max) == (255, 255)
    assert (variable("numbers.eds", 0x2005).default, variable("numbers.eds", 0x2005).access_type) == (b"\xaa\xbb", "rw")


def test_limits_outside_their_type_are_reported_and_ignored() -> None:
    repairs = repaired("limits.eds")
    found = {index: (item.min, item.max) for index in range(0x2001, 0x2006) if (item := variable("limits.eds", index))}
    assert found == {
        0x2001: (None, None),
        0x2002: (None, None),
        0x2003: (0, None),
        0x2004: (None, 9),
        0x2005: (-128, -1),
    }
    assert {key for key in repairs if key[1].endswith("Limit")} == {
        ("2001", "LowLimit"),
        ("2001", "HighLimit"),
        ("2002", "LowLimit"),
        ("2002", "HighLimit"),
        ("2003", "HighLimit"),
        ("2004", "LowLimit"),
    }


@pytest.mark.parametrize(
    ("index", "default"),
    [
        (0x2001, 0x185),
        (0x2002, 0x185),
        (0x2003, 0x185),
        (0x2004, 0x185),
        (0x2005, 5),
        (0x2006, 0x8000_0185),
        (0x2007, 0x185),
    ],
)
def test_every_spelling_of_the_node_id_is_relative_to_it(index: int, default: int) -> None:
    found = variable("node_id.eds", index)
    assert (found.default, found.relative) == (default, True)


def test_the_elements_of_an_array_have_their_own_types() -> None:
    switches = import_eds(CORPUS / "repaired" / "counts.eds", NODE).dictionary[0x2007]
    assert [(switches[sub].default, switches[sub].data_type) for sub in (1, 2)] == [(1, 1), (5, 6)]


def test_missing_sub_index_0_and_missing_objects_are_added() -> None:
    assert variable("counts.eds", 0x2009, 0).default == 3
    assert variable("counts.eds", 0x200A, 1).data_type == 5


def test_the_kind_of_an_object_follows_its_sections() -> None:
    dictionary = import_eds(CORPUS / "repaired" / "counts.eds", NODE).dictionary
    assert list(dictionary[0x200B]) == [0, 1]
    assert isinstance(dictionary[0x200C], canopen.objectdictionary.ODVariable)


def test_unknown_types_are_bytes_and_an_editors_types_are_looked_up() -> None:
    assert variable("counts.eds", 0x200D).data_type == 0x0F
    assert (variable("counts.eds", 0x200E).data_type, variable("counts.eds", 0x200E).default) == (4, 5)


def test_lists_name_the_described_objects() -> None:
    text = import_eds(CORPUS / "repaired" / "counts.eds", NODE).text
    assert "[ManufacturerObjects]\nSupportedObjects=7\n1=0x2007\n" in text
    assert "[OptionalObjects]\nSupportedObjects=0\n\n" in text
    assert "[2007]\nParameterName=Switches\nObjectType=0x8\nSubNumber=3\n" in text


def test_layout() -> None:
    imported = import_eds(CORPUS / "repaired" / "layout.eds", NODE)
    device_type = imported.dictionary[0x1000]
    assert (device_type.name, device_type.data_type, device_type.access_type) == ("Device type", 7, "ro")
    assert device_type.default == 0x20192
    assert imported.dictionary[0x1018][1].default is None, "[DEFAULT] is no default of anything"
    assert imported.dictionary[0x1018].name == "Identity"
    assert imported.dictionary.device_information.product_number == 7
    assert "[Custom Tool]\nColour=blue\n" in imported.text


# -- refusals ---------------------------------------------------------------------------------------------------------


def test_everything_that_has_to_be_corrected_is_named_with_its_line() -> None:
    path = CORPUS / "refused" / "ambiguous.eds"
    with pytest.raises(CanopenError) as error:
        import_eds(path, NODE)
    assert isinstance(error.value, EdsError)
    lines = path.read_text().splitlines()
    for problem in error.value.problems:
        assert problem.found in lines[problem.line - 1], problem
    assert [(problem.section, problem.key) for problem in error.value.problems] == [
        ("DeviceInfo", "VendorNumber"),
        ("2001", "DataType"),
        ("2005", "ObjectType"),
        ("2006", "DataType"),
        ("2008sub100", "sub-index"),
        ("1400", ""),
    ]
    assert "line 2 [DeviceInfo] VendorNumber 'abc': not a number" in str(error.value)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "describes no object"),
        (b"\x7fELF\0\0\0binary", "binary data"),
        (b"\xff\xfeA", "cut or damaged"),
        (b"[1000]\nParameterName=x\nDataType=7\nAccessType=ro\n[1000x\nDataType=7", "must end with ]"),
        (b"PK\x03\x04\x14\0", "a ZIP archive: unpack it, expected an EDS or DCF"),
        (b"\r\n<!DOCTYPE html>\n<html>", "a web page: download the file itself"),
        (b'\xef\xbb\xbf<?xml version="1.0"?>\n<EtherCATInfo Version="1.6">', "an ESI file"),
        (b'<ISO15745Profile xmlns="http://www.profibus.com/GSDML/2003/11/DeviceProfile">', "a GSDML file"),
        (b'<ISO15745ProfileContainer xmlns="http://www.canopen.org/xml/1.0">', "an XDD or XDC file"),
    ],
)
def test_files_other_than_data_sheets_are_rejected(data: bytes, reason: str) -> None:
    with pytest.raises(EdsError, match=reason):
        import_eds(data, NODE)


def test_file_with_too_many_entries_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    assert importer.MAX_ENTRIES == 32_768
    monkeypatch.setattr(importer, "MAX_ENTRIES", 500)
    compact = (b"[%04X]\nObjectType=8\nDataType=7\nCompactSubObj=254\n" % index for index in (0x2000, 0x2001))
    with pytest.raises(EdsError, match="too long, allowed: 500"):
        import_eds(b"".join(compact), NODE)


@pytest.mark.parametrize("node_id", [0, 128, -1])
def test_impossible_node_id_is_rejected(node_id: int) -> None:
    with pytest.raises(CanopenError, match=r"1\.\.127"):
        import_eds(GOOD, node_id)


def test_a_file_that_is_too_large_is_rejected(tmp_path: Path) -> None:
    path = tmp_path / "large.eds"
    path.write_bytes(bytes(5 << 20))
    with pytest.raises(EdsError, match="longer than 4194304 bytes"):
        import_eds(path, NODE)


def test_directory_instead_of_a_file_is_rejected() -> None:
    with pytest.raises(CanopenError, match="directory"):
        import_eds(CORPUS, NODE)


@pytest.mark.parametrize(
    ("data_type", "text", "default"),
    [
        (0x02, "0xFF", -1),
        (0x03, "0x8000", -32768),
        (0x10, "0xFFFFFF", -1),
        (0x15, "0xFFFFFFFFFFFFFFFE", -2),
        (0x07, "0XFfFf", 0xFFFF),
        (0x09, "010", "010"),
        (0x0F, "0102", b"\x01\x02"),
    ],
)
def test_right_values_are_not_repaired(data_type: int, text: str, default: object) -> None:
    imported = import_eds(simple(f"DefaultValue={text}", data_type), NODE)
    assert imported.repairs == ()
    assert imported.dictionary[0x2000].default == default


@pytest.mark.parametrize(
    ("data_type", "text"),
    [
        (0x07, "010"),
        (0x07, "1e3"),
        (0x07, "$NODEID*2"),
        (0x07, "$NODEID+$NODEID"),
        (0x07, "0x80-$NODEID"),
        (0x07, "$NODEID+"),
        (0x07, "$NODEID 5"),
        (0x05, "300"),
        (0x04, "0x1FFFFFFFFFFFFFFFF"),
        (0x05, "1.5"),
        (0x05, "bad"),
        pytest.param(0x07, "9" * 5000, id="long"),
        pytest.param(0x07, "5" + " " * 1_000_000 + "x", id="blanks"),
        (0x08, "nan"),
        (0x0A, "text"),
        (0x01, "maybe"),
    ],
)
def test_a_default_with_no_or_two_meanings_is_omitted(data_type: int, text: str) -> None:
    imported = import_eds(simple(f"DefaultValue={text}", data_type), NODE)
    assert imported.repairs == (Repair(7, "2000", "DefaultValue", text, ""),)
    assert imported.dictionary[0x2000].default is None


@pytest.mark.parametrize(
    ("data_type", "text", "default"),
    [
        (0x1B, "0x00000000000000A1LL", 0xA1),
        (0x07, "42u", 42),
        (0x07, "0xFFUL", 0xFF),
        (0x06, "-2", 0xFFFE),
        (0x04, "0xFFFFFFFFFFFFFFFE", -2),
        (0x08, "0x3FC00000", 1.5),
        (0x11, "0x3FF8000000000000", 1.5),
        (0x08, "1,5", 1.5),
        (0x0C, "365 43200000", 365 << 32 | 43_200_000),
    ],
)
def test_values_as_makers_write_them(data_type: int, text: str, default: object) -> None:
    imported = import_eds(simple(f"DefaultValue={text}", data_type), NODE)
    assert imported.dictionary[0x2000].default == default


@pytest.mark.parametrize(
    ("found", "used"),
    [("R/O", "ro"), ("read write", "rw"), ("UNKNOWN", "rw"), ("", "rw"), ("rw # both", "rw"), ("Const", "const")],
)
def test_access_types_as_makers_write_them(found: str, used: str) -> None:
    content = simple("").replace(b"AccessType=rw", f"AccessType={found}".encode())
    assert import_eds(content, NODE).dictionary[0x2000].access_type == used


def test_two_values_of_one_key_are_rejected() -> None:
    imported = import_eds(simple("DefaultValue=1\nDefaultValue=2\nParameterValue=3\nParameterValue=0x3"), NODE)
    assert (imported.dictionary[0x2000].default, imported.dictionary[0x2000].value) == (None, 3)
    assert [(repair.line, repair.used) for repair in imported.repairs] == [(8, ""), (10, "3")]


def test_a_compact_object_has_at_most_254_elements() -> None:
    content = simple("ObjectType=8\nCompactSubObj=255\nDefaultValue=1")
    imported = import_eds(content, NODE)
    assert (max(imported.dictionary[0x2000]), imported.dictionary[0x2000][254].default) == (254, 1)
    assert imported.repairs == (Repair(8, "2000", "CompactSubObj", "255", "254"),)


def test_zero_bytes_at_the_end_are_a_repair() -> None:
    imported = import_eds(simple("DefaultValue=5\n") + b"\0\0\0", NODE)
    assert [repair.key for repair in imported.repairs] == ["end of file"]
    assert imported.dictionary[0x2000].default == 5


COMPACT_PDOS = b"[DeviceInfo]\nNrOfRXPDO=4\nNrOfTXPDO=2\nCompactPDO=0x1F\n"


def test_compact_pdos_are_written_out() -> None:
    imported = import_eds(COMPACT_PDOS + simple("").partition(b"[DeviceInfo]\n")[2], NODE)
    found = [index for index in imported.dictionary if index < 0x2000]
    assert found == [*range(0x1400, 0x1404), *range(0x1600, 0x1604), 0x1800, 0x1801, 0x1A00, 0x1A01]
    assert imported.repairs == ()
    assert len(canopen.RemoteNode(NODE, imported.dictionary).rpdo) == 4


def test_a_described_pdo_stays_as_it_is_beside_compact_ones() -> None:
    described = b"[1600]\nParameterName=Own\nObjectType=9\n[1600sub0]\nDataType=5\nParameterName=n\nAccessType=rw\n"
    imported = import_eds(COMPACT_PDOS + simple("").partition(b"[DeviceInfo]\n")[2] + described, NODE)
    assert (imported.dictionary[0x1600].name, len(imported.dictionary[0x1600])) == ("Own", 1)
    assert 0x1400 in imported.dictionary
