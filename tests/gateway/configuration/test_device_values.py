"""``dcf`` and ``[axis.objects]`` in a configuration: what is read, and each mistake with its line."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.objects import CanType, var
from pdgw.ds301.values import DeviceValue
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.configuration.check import references_wrong
from pdgw.gateway.configuration.device_values import address_of, is_owned
from pdgw.gateway.configuration.file import config_text, load_config, parse_config
from tests.support.cli import pdgw
from tests.support.drives.dcf import dcf_text, makers_objects, write_dcf

BASE = '[can]\ninterface = "virtual"\nchannel = "x"\n[[axis]]\ndo_id = 1\nnode_id = 5\ntelegram = 9\n'


def _file(folder: Path, more: str) -> Path:
    file = folder / "gateway.toml"
    file.write_text(BASE + more)
    return file


def _wrong(folder: Path, more: str) -> str:
    result = pdgw("config", "check", str(_file(folder, more)))
    assert result.returncode == 1
    return result.stderr or result.stdout


@pytest.mark.parametrize(
    ("name", "address"),
    [
        ("6085h", (0x6085, 0)),
        ("2210h.3", (0x2210, 3)),
        ("2210h/3", (0x2210, 3)),
        ("0x2210.255", (0x2210, 255)),
        ("2210h.256", None),
        ("P922", None),
        ("22100h", None),
        ("", None),
    ],
)
def test_name_of_an_object_is_index_and_subindex(name: str, address: tuple[int, int] | None) -> None:
    assert address_of(name) == address


def test_objects_that_command_or_erase_a_device_are_the_gateways_own() -> None:
    owned = {index for index in range(0x1000, 0x10000) if is_owned(index)}
    assert {0x1003, 0x1010, 0x1017, 0x1020, 0x1400, 0x1BFF, 0x1F51, 0x6003, 0x6040, 0x6042, 0x6060, 0x607A} <= owned
    assert {0x6098, 0x6099, 0x60B0, 0x60C2, 0x60FE, 0x60FF, 0x6007, 0x100C} <= owned
    assert owned.isdisjoint({0x1000, 0x1018, 0x1029, 0x1C00, 0x2000, 0x5FFF, 0x605A, 0x6072, 0x6081, 0x6085, 0x60F2})


@pytest.mark.parametrize(
    ("table", "line", "says"),
    [
        ('"6085h" = 1\n"6040h" = 6\n', 10, "6040h: the gateway itself writes this object"),
        ('"6040h" = 6\n"1400h.1" = 6\n', 9, "6040h, 1400h.1: the gateway itself writes this object"),
        ('"1F51h.1" = 3\n', 9, "1F51h.1: the gateway itself"),
        ('"speed" = 3\n', 9, "'speed' is not an object, expected for example"),
        ('"6085h" = 3\n"0x6085" = 3\n', 10, "0x6085: the object is there twice"),
        ('"6085h" = true\n', 9, "6085h = True"),
        ('"6085h" = [3]\n', 9, "6085h"),
    ],
)
def test_mistake_in_a_table_of_objects_is_named_by_its_line(tmp_path: Path, table: str, line: int, says: str) -> None:
    text = _wrong(tmp_path, f"[axis.objects]\n{table}")
    assert f"gateway.toml:{line}: " in text
    assert says in text


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ('"6085h" = "fast"', "6085h of [axis.objects]: 'fast' is not allowed, expected a number"),
        ('"6085h" = 4294967296', "6085h of [axis.objects]: 4294967296 is not allowed, expected a number of 4 bytes"),
        ('"6085h" = -1', "6085h of [axis.objects]: -1 is not allowed, expected a number of 4 bytes"),
        ('"6085h" = 1.5', "6085h of [axis.objects]: 1.5 is not allowed, expected a number without a point"),
        ('"2210h" = 5', "2210h of [axis.objects]: 5 is not allowed, expected a text in quotation marks"),
        ('"2210h" = "\\u20ac"', "expected letters of Latin-1"),
        (
            '"6065h" = 5',
            "6065h of [axis.objects]: '5' is not allowed, expected 9000 as in drive.dcf; delete one of both",
        ),
    ],
)
def test_value_that_is_none_of_its_type_is_an_error_of_the_check(tmp_path: Path, table: str, says: str) -> None:
    write_dcf(tmp_path / "drive.dcf", {"6065": 9000}, objects=makers_objects(0))
    text = _wrong(tmp_path, f'dcf = "drive.dcf"\n[axis.objects]\n{table}\n')
    assert "gateway.toml:9: [[axis]] number 1 objects: " in text
    assert says in text


def test_both_sources_may_have_the_same_value(tmp_path: Path) -> None:
    write_dcf(tmp_path / "drive.dcf", {"6065": 9000, "6073": 7}, stamp=15_000)
    config = load_config(_file(tmp_path, 'dcf = "drive.dcf"\n[axis.objects]\n"6065h" = 9000\n"6067h" = 3\n'))
    values = config.axis[0].device_values("axis")
    assert [(item.name, item.value) for item in values.items] == [("6065h", 9000), ("6073h", 7), ("6067h", 3)]
    assert values.source == "drive.dcf and [axis.objects]"
    assert values.date == (0, 0), "single values are compared each time"


def test_a_dcf_alone_is_the_data_sheet_too(tmp_path: Path) -> None:
    write_dcf(tmp_path / "drive.dcf", {"6065": 9000, "1400sub1": "$NODEID+0x200", "605D": 1}, stamp=15_000)
    config = load_config(_file(tmp_path, 'dcf = "drive.dcf"\n'))
    axis = config.axis[0]
    values = axis.device_values("axis")
    assert axis.eds == axis.dcf == tmp_path / "drive.dcf"
    assert (len(values.items), values.skipped, values.date) == (2, 3, (15_000, 15_000))
    assert parse_config(config_text(config)).axis[0].dcf == axis.dcf


def test_the_objects_survive_a_round_trip_of_the_configuration() -> None:
    config = parse_config(BASE + '[axis.objects]\n"6085h" = 20000\n"2210h.3" = "a \\"b\\""\n"2211h" = 0.5\n')
    assert parse_config(config_text(config)) == config


def test_a_dcf_that_is_missing_is_named_by_its_key(tmp_path: Path) -> None:
    with pytest.raises(GatewayError, match=r"gateway\.toml:8: \[\[axis\]\] number 1 dcf = '.*drive\.dcf': not a file"):
        load_config(_file(tmp_path, 'dcf = "drive.dcf"\n'))


# -- bad files --------------------------------------------------------------------------------------------------------------


def _values(folder: Path, text: str | bytes) -> list[DeviceValue]:
    file = folder / "drive.dcf"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return list(load_config(_file(folder, 'dcf = "drive.dcf"\n')).axis[0].device_values("axis").items)


def test_a_node_id_in_a_value_is_that_of_the_axis(tmp_path: Path) -> None:
    (item,) = _values(tmp_path, dcf_text({"6065": "$NODEID+0x100"}))
    assert item.value == 0x105


@pytest.mark.parametrize("encoding", ["latin-1", "utf-8-sig", "utf-16"])
def test_a_file_in_another_encoding_has_the_same_values(tmp_path: Path, encoding: str) -> None:
    text = dcf_text({"6065": 9000, "2210": "F\xf6rderer"}, objects=makers_objects(0))
    assert [item.value for item in _values(tmp_path, text.encode(encoding))] == ["F\xf6rderer", 9000]


def test_a_file_with_10000_values_is_read(tmp_path: Path) -> None:
    objects = makers_objects(10_000)
    given = {f"{spec.index:04X}sub{n:X}": n for spec in objects[:-2] for n in range(1, len(spec.entries))}
    assert len(_values(tmp_path, dcf_text(given, objects=objects))) == 10_000


@pytest.mark.parametrize("value", ["abc", "4294967296", "1.5", "0x"])
def test_a_value_that_is_none_of_its_type_is_named_by_its_line(tmp_path: Path, value: str) -> None:
    text = dcf_text({"6065": value, "6067": 3})
    if value == "0x":
        assert [item.name for item in _values(tmp_path, text)] == ["6067h"]
        return
    line = text.splitlines().index("[6065]") + 2
    with pytest.raises(CanopenError, match=re.escape(f"line {line} [6065] ParameterValue {value!r}: not a value")):
        _values(tmp_path, text)
    wrong = references_wrong(load_config(tmp_path / "gateway.toml"), tmp_path / "gateway.toml")
    assert wrong[0].startswith(f"{tmp_path}/gateway.toml:8: [[axis]] number 1 dcf: DCF: ")


def test_what_is_wrong_in_owned_objects_and_what_cannot_be_written_is_left_out(tmp_path: Path) -> None:
    text = dcf_text({"6060": "abc", "6041": 3, "6065": 9000}).replace(
        "[6067]\n", "[6067]\nParameterValue=5\nParameterValue=6\n"
    )
    with pytest.raises(CanopenError, match=r"\[6067\] ParameterValue '6'"):
        _values(tmp_path, text)
    assert [item.name for item in _values(tmp_path, dcf_text({"6060": "abc", "6041": 3, "6065": 9000}))] == ["6065h"]


def test_a_value_that_the_telegram_forbids_is_an_error_of_the_check(tmp_path: Path) -> None:
    write_dcf(tmp_path / "drive.dcf", {"605D": 0})
    says = "telegram 9 is rejected: drive.dcf: Halt Option Code 605Dh: 0 is not allowed, expected 1"
    assert says in _wrong(tmp_path, 'dcf = "drive.dcf"\n')


def test_a_file_without_a_drive_is_refused_as_a_data_sheet_is(tmp_path: Path) -> None:
    (tmp_path / "drive.dcf").write_text("[FileInfo]\n")
    assert "gateway.toml:8: [[axis]] number 1 dcf = " in _wrong(tmp_path, 'dcf = "drive.dcf"\n')


def test_a_value_that_is_too_large_with_the_node_id_is_named(tmp_path: Path) -> None:
    objects = (*makers_objects(0), var(0x2220, "Byte", CanType.U8))
    with pytest.raises(CanopenError, match=r"\[2220h\] ParameterValue '260': expected a number of 1 bytes"):
        _values(tmp_path, dcf_text({"2220": "$NODEID+0xFF"}, objects=objects))
    with pytest.raises(CanopenError, match=r"\[2210h\] ParameterValue '\u20ac': expected letters of Latin-1"):
        _values(tmp_path, dcf_text({"2210": "\u20ac"}, objects=objects))
