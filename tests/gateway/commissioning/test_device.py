"""The device of a drive object without a gateway: saved, compared and written in a world, beside python canopen."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any, TypeVar

import canopen
import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.eds.dcf import stamp_of
from pdgw.ds301.eds.pdos import variables
from pdgw.dsp402.drive.own_values import OwnValue, OwnValues
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.store import ParameterStore
from pdgw.gateway.commissioning.device import ConfiguredDevice, Difference
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.file import parse_config
from pdgw.peers.drive import SimulatedDrive
from pdgw.peers.drive.objects import EDS_PATH
from pdgw.peers.encoder import SimulatedEncoder
from pdgw.peers.node.node import SimulatedNode
from pdgw.peers.world import World
from tests.support.drives.dcf import makers_objects, write_dcf
from tests.support.gateways.canopen_master import master

T = TypeVar("T")
BUS = "machine"
NOW = datetime(2026, 11, 29, 3, 4, 5)
DRIVE = '[can]\ninterface = "virtual"\nchannel = "machine"\n[[axis]]\ndo_id = 1\nnode_id = 5\ntelegram = 1\n'
ENCODER = '[can]\ninterface = "virtual"\nchannel = "machine"\n[[encoder]]\ndo_id = 2\nnode_id = 20\ntelegram = 83\n'
DCF = {"6085": 1200, "6065": 9000}


class Site:
    """A bus with one device, asked by its configuration."""

    def __init__(self, text: str = DRIVE, store: Path | None = None, **options: Any) -> None:
        self.world = World()
        self.config: GatewayConfig = parse_config(text).model_copy(update={"store": store})
        add = self.world.drive if self.config.axis else self.world.encoder
        self.device: SimulatedDrive | SimulatedEncoder = add(BUS, self.config.objects[0].node_id, **options)
        bus = self.config.can[0]
        self.network = CanNetwork(self.world.loop, lambda: self.world.open_can(bus))
        self.network.start()

    @property
    def node(self) -> SimulatedNode:
        return self.device.node

    def run(self, method: Callable[[ConfiguredDevice], T], do_id: int | None = None) -> T:
        device = ConfiguredDevice(self.network, self.config, do_id or self.config.objects[0].do_id)

        def alone() -> T:
            with device.opened():
                return method(device)

        return self.world.loop.complete(alone)

    def differences(self) -> list[Difference]:
        return self.run(lambda device: device.differences())

    def save(self, folder: Path) -> tuple[Path, int]:
        text, count = self.run(lambda device: device.save(NOW, None))
        (folder / "saved.dcf").write_bytes(text.encode())
        return folder / "saved.dcf", count


def _with_dcf(path: Path, values: dict[str, Any], **options: Any) -> str:
    return f'{DRIVE}dcf = "{write_dcf(path, values, **options)}"\n'


# -- saving -----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("with_sheet", [True, False])
def test_python_canopen_reads_the_saved_file_with_the_values_of_the_device(tmp_path: Path, with_sheet: bool) -> None:
    eds = write_dcf(tmp_path / "drive.eds", {}, objects=makers_objects(7))
    site = Site(f'{DRIVE}eds = "{eds}"\n' if with_sheet else DRIVE)
    if with_sheet:
        for spec in makers_objects(7):
            for entry in spec.entries:
                site.node.indices.add(entry.index)
                site.node.entries[entry.address] = entry
                site.node.values[entry.address] = entry.default or "press 3"
    site.node.values[0x607C, 0] = -77
    file, count = site.save(tmp_path)
    read = canopen.import_od(str(file), 5)
    assert (read.node_id, read.bitrate) == (5, 1_000_000)
    information = read.device_information
    assert (information.vendor_number, information.product_number) == (
        site.node.values[0x1018, 1],
        site.node.values[0x1018, 2],
    )
    values = {(item.index, item.subindex): item for item in variables(read) if item.value is not None}
    with master(site.world, BUS) as tool:
        node = tool.add_node(canopen.RemoteNode(5, read))
        for (index, subindex), item in values.items():
            assert item.decode_raw(node.sdo.upload(index, subindex)) == item.value, hex(index)
    assert len(values) == count >= (30 if with_sheet else 15)
    assert values[0x607C, 0].value == -77
    assert (0x6040, 0) not in values
    assert "Line1=" in file.read_text("latin-1")


def test_what_changes_is_owned_or_cannot_be_read_is_a_comment(tmp_path: Path) -> None:
    eds = write_dcf(tmp_path / "drive.eds", {}, objects=makers_objects(1))
    site = Site(f'{DRIVE}eds = "{eds}"\n')

    def count() -> None:
        site.node.values[0x6067, 0] = int(site.node.values[0x6067, 0]) + 1
        site.world.loop.call_later(100 * MS, count)

    count()
    text = site.save(tmp_path)[0].read_text("latin-1")
    assert "6067h: changed while it was read (" in text
    assert "6040h: written by the gateway itself" in text
    assert "2301h" not in text
    assert "2211h: cannot be read, 0602 0000h: object does not exist" in text
    assert "[6067]\n" in text
    assert "ParameterValue" not in text.partition("[6067]\n")[2].partition("[")[0]


def test_a_text_that_no_line_can_have_is_a_comment(tmp_path: Path) -> None:
    eds = write_dcf(tmp_path / "drive.eds", {}, objects=makers_objects(0))
    site = Site(f'{DRIVE}eds = "{eds}"\n')
    entry = makers_objects(0)[0].entries[0]
    site.node.indices.add(entry.index)
    site.node.entries[entry.address] = entry
    for text in ("a\nb", "a ;b", " a", "a\x07"):
        site.node.values[entry.address] = text
        assert f"2210h: {text!r} cannot be in a line of a DCF" in site.save(tmp_path)[0].read_text("latin-1")


def test_date_and_time_are_the_values_of_1020h(tmp_path: Path) -> None:
    site = Site(habits={"verify-configuration": {}})
    file, _ = site.save(tmp_path)
    read = canopen.import_od(str(file), 5)
    assert [read[0x1020][sub].value for sub in (1, 2)] == list(stamp_of(NOW)) == [15673, 11_045_000]


def test_a_saved_file_is_the_whole_configuration_of_another_device(tmp_path: Path) -> None:
    sound = Site()
    sound.node.values[0x6085, 0] = 4321
    file, _ = sound.save(tmp_path)
    spare = Site(f'{DRIVE}dcf = "{file}"\n', serial_number=77)
    assert [(item.item.name, item.item.text(), item.held) for item in spare.differences()] == [
        ("6085h", "4321", "1000")
    ]


def test_the_drives_own_value_is_saved_where_the_gateway_has_overwritten_it(tmp_path: Path) -> None:
    store = tmp_path / "store.json"
    site = Site(store=store)
    identity = (int(site.node.values[0x1018, 1]), int(site.node.values[0x1018, 2]), 1)
    kept = OwnValues(identity, (OwnValue(0x6083, 0, 4, 250),))
    ParameterStore(store, print).update(lambda stored: setattr(stored.drive_object(1), "own_values", kept))
    file, _ = site.save(tmp_path)
    assert canopen.import_od(str(file), 5)[0x6083].value == 250
    compared = Site(f'{DRIVE}[axis.objects]\n"6083h" = 250\n', store=store)
    assert compared.differences() == []


def test_an_encoder_is_saved(tmp_path: Path) -> None:
    site = Site(ENCODER)
    file, count = site.save(tmp_path)
    assert count > 2
    assert canopen.import_od(str(file), 20)[0x6001].value == site.node.read(0x6001)


# -- comparing and writing ----------------------------------------------------------------------------------------------------


def test_differences_have_name_file_and_device(tmp_path: Path) -> None:
    site = Site(_with_dcf(tmp_path / "drive.dcf", DCF))
    assert [(item.item.name, item.name, item.item.text(), item.held) for item in site.differences()] == [
        ("6065h", "Following Error Window", "9000", "16384"),
        ("6085h", "Quick Stop Deceleration", "1200", "1000"),
    ]


def test_writing_and_storing_has_the_order_of_the_standard(tmp_path: Path) -> None:
    text = _with_dcf(tmp_path / "drive.dcf", {**DCF, "6094sub1": 4}, stamp=15_000)
    site = Site(text, habits={"verify-configuration": {"value": 7}})
    written: list[tuple[int, int]] = []
    set_data = site.node.set_data

    def note(index: int, subindex: int, data: bytes, check_writable: bool = False) -> None:
        written.append((index, subindex))
        set_data(index, subindex, data, check_writable)

    site.node.set_data = note  # type: ignore[method-assign]
    late = site.run(lambda device: device.write())
    assert [item.name for item in late] == ["6094h.1"]
    assert not site.run(lambda device: device.is_stored)
    assert site.run(lambda device: device.store())
    assert written == [
        *[(0x1020, 1), (0x1020, 2), (0x6094, 1), (0x6065, 0), (0x6085, 0)],
        *[(0x1020, 1), (0x1020, 2), (0x1010, 1)],
    ]
    site.device.do(lambda node: node.restart())
    assert [site.node.values[address] for address in ((0x6085, 0), (0x6094, 1), (0x1020, 1))] == [1200, 4, 15_000]
    assert site.differences() == []
    assert site.run(lambda device: device.is_stored)


def test_a_drive_with_power_is_not_written(tmp_path: Path) -> None:
    site = Site(_with_dcf(tmp_path / "drive.dcf", DCF))
    with master(site.world, BUS) as tool:
        node = tool.add_node(5)
        for word in (6, 7, 15):
            node.sdo.download(0x6040, 0, word.to_bytes(2, "little"))
    for method in (ConfiguredDevice.write, ConfiguredDevice.store):
        with pytest.raises(GatewayError, match="without power; the drive is in Operation Enabled: switch its power"):
            site.run(method)
    assert site.node.values[0x6085, 0] == 1000


def test_a_device_that_does_not_store_is_named(tmp_path: Path) -> None:
    site = Site(_with_dcf(tmp_path / "drive.dcf", DCF), habits={"write-refused": {"index": 0x1010}})
    with pytest.raises(CanopenError, match="storing of all parameters"):
        site.run(lambda device: device.store())


def test_a_missing_device_and_a_missing_file_are_named() -> None:
    site = Site()
    with pytest.raises(GatewayError, match="DO 1 has neither dcf nor a table of objects; pdgw device save"):
        site.differences()
    with pytest.raises(GatewayError, match=r"DO 9: not in the configuration, allowed: \[1\]"):
        site.run(lambda device: device.differences(), 9)
    site.device.do(lambda node: node.power_off())
    site.world.bus(BUS).join("another device")
    with pytest.raises(GatewayError, match=r"DO 1: no answer from node 5 .*; pdgw bus scan lists the nodes"):
        site.differences()


def test_beside_a_gateway_nothing_is_read(tmp_path: Path) -> None:
    site = Site(_with_dcf(tmp_path / "drive.dcf", DCF))
    other = site.world.bus(BUS).join("gateway of others")

    def beat() -> None:
        other.send(0x700 + 127, b"\x05")
        site.world.loop.call_later(SECOND // 10, beat)

    beat()
    before = site.network.sent
    with pytest.raises(
        GatewayError, match=r"a master sends the heartbeat of a gateway \(node 127\); allowed: none. End"
    ):
        site.differences()
    assert site.network.sent == before


def test_a_gateway_that_starts_meanwhile_is_found_at_the_end(tmp_path: Path) -> None:
    site = Site(_with_dcf(tmp_path / "drive.dcf", DCF))
    other = site.world.bus(BUS).join("gateway of others")

    def compared(device: ConfiguredDevice) -> None:
        device.differences()
        other.send(0x700 + 127, b"\x05")
        site.world.loop.sleep(SECOND // 100)

    with pytest.raises(GatewayError, match="a master sends the heartbeat of a gateway"):
        site.run(compared)


# -- python canopen as the device ---------------------------------------------------------------------------------------------


def test_a_device_of_python_canopen_is_saved_compared_and_written(tmp_path: Path) -> None:
    site = Site(_with_dcf(tmp_path / "drive.dcf", DCF))
    site.device.do(lambda node: node.power_off())
    with master(site.world, BUS) as other:
        dictionary = canopen.import_od(str(EDS_PATH), 5)
        node = other.create_node(5, dictionary)
        for address in ((0x1000, 0), (0x1018, 1), (0x1018, 2), (0x1018, 3), (0x1018, 4)):
            node.set_data(*address, int(site.node.values[address]).to_bytes(4, "little"))
        node.set_data(0x6041, 0, b"\x40\x00")
        assert [(item.item.name, item.held) for item in site.differences()] == [("6065h", "16384"), ("6085h", "1000")]
        assert site.run(lambda device: device.write()) == []
        assert [int.from_bytes(node.get_data(index, 0), "little") for index in (0x6065, 0x6085)] == [9000, 1200]
        assert site.differences() == []
        file, count = site.save(tmp_path)
        read = canopen.import_od(str(file), 5)
        found = [item for item in variables(read) if item.value is not None]
        assert len(found) == count > 20
        assert [item.value for item in found] == [
            item.decode_raw(node.get_data(item.index, item.subindex)) for item in found
        ]
