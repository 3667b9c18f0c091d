"""Parameters of a PROFINET station by a device access relationship, while its controller turns a drive."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from pdgw.base.durations import MS
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.client import udp as client_module
from pdgw.gateway.client.udp import ParameterClient, read_identification
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.parameters.codec import ParameterAddress, Values
from pdgw.profinet.blocks.connect_blocks import ArType
from pdgw.profinet.rpc import identification
from pdgw.profinet.rpc.dcerpc import object_uuid
from pdgw.tools.cli import app
from tests.support.gateways.daemon import axis
from tests.support.gateways.profinet_daemon import Plant, PlantChannel, configuration, plant

STATION = ("192.168.0.2", 34964)


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Plant]:
    with plant(configuration(axis(1) + axis(2), tmp_path / "store.json")) as made:
        made.connect()
        made.enable(1, 0x1000)
        yield made


def test_parameters_are_read_beside_the_controller_and_the_relationship_ends_with_the_client(site: Plant) -> None:
    with ParameterClient(STATION, 1, channel=PlantChannel(site)) as client:
        client.connect()
        kinds = [item.plan.ar.ar_type for item in site.link.device.cm.relations.values()]
        assert kinds == [ArType.IO, ArType.DEVICE_ACCESS]
        profile, telegram = client.request([ParameterAddress(965), ParameterAddress(922)])
        assert (list(profile.values), list(telegram.values)) == ([0x0329], [1])
        client.do_id = 2
        assert list(client.request([ParameterAddress(922)])[0].values) == [1]
    site.run(20 * MS)
    assert len(site.link.device.cm.relations) == 1
    assert site.link.connected
    assert site.word(1) & 0x4F == 0x07, "the drive turns as before"


def test_station_reports_its_controller_for_every_query(tmp_path: Path) -> None:
    numbers = "vendor_id = 0x0123\ndevice_id = 0x0456"
    with plant(configuration(axis(1) + axis(2), tmp_path / "store.json", transport=numbers)) as site:
        site.connect()
        told: list[bytes] = []
        site.plc.read((0, 0, 1), identification.INDEX, lambda result: told.append(result.data[6:8]))
        site.until(lambda: told, "I&M0")
        assert told == [b"\1\x23"]
        with ParameterClient(STATION, 0, channel=PlantChannel(site)) as client:
            client.connect()
            for do_id, pnu in ((0, 964), (0, 975), (1, 975)):
                client.do_id = do_id
                (found,) = client.request([ParameterAddress(pnu, 0, 2)])
                assert list(found.values) == [0x0123, 0x0456]
        assert site.link.device.cm._object == object_uuid(1, 0x0456, 0x0123)


def test_the_identification_of_a_station_is_that_of_its_device(site: Plant) -> None:
    for slot in (0, 1):
        with ParameterClient(STATION, 0, channel=PlantChannel(site), slot=slot) as client:
            client.connect()
            assert read_identification(client)["Order ID"] == "PDGW"


def test_writing_needs_the_stations_permission(site: Plant) -> None:
    with ParameterClient(STATION, 1, channel=PlantChannel(site)) as client:
        client.connect()
        with pytest.raises(GatewayError, match="writing record B02Fh failed: access denied"):
            client.request([ParameterAddress(925)], [Values(DataType.UNSIGNED16, (5,))])


def test_station_without_free_accesses_rejects_with_its_reason(site: Plant) -> None:
    clients = [ParameterClient(STATION, 1, channel=PlantChannel(site)) for _ in range(2)]
    for client in clients:
        client.connect()
    third = ParameterClient(STATION, 1, channel=PlantChannel(site))
    with pytest.raises(GatewayError, match=r"device access failed: no AR free .DB 81 40 04."):
        third.connect()


def test_without_a_connect_the_station_refuses_the_records(site: Plant) -> None:
    client = ParameterClient(STATION, 1, channel=PlantChannel(site))
    with pytest.raises(GatewayError):
        client.request([ParameterAddress(965)])


def test_param_command_reads_a_station(site: Plant, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, int]] = []

    def channel(address: tuple[str, int]) -> PlantChannel:
        asked.append(address)
        return PlantChannel(site)

    monkeypatch.setattr(client_module, "UdpChannel", channel)
    command = ["param", "--profinet", "read", "P965", "P922", "--gateway", "192.168.0.2", "--json"]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0, result.output
    assert asked == [STATION]
    assert [item["value"] for item in json.loads(result.output)] == [0x0329, 1]
    site.run(20 * MS)
    assert len(site.link.device.cm.relations) == 1
