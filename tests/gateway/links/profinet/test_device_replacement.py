"""Device replacement: a controller finds the new gateway at its place in the topology, names it and connects; no drive starts."""

from __future__ import annotations

from pathlib import Path

from scapy.contrib.pnio_dcp import ProfinetDCP
from scapy.layers.l2 import Ether

from pdgw.dsp402.states import State
from pdgw.durations import MS, SECOND
from pdgw.profinet.discovery import lldp
from pdgw.profinet.station import Identity, Station
from tests.support.gateways.daemon import axis, drive_of
from tests.support.gateways.profinet_daemon import ON, Plant, configuration, plant
from tests.support.wire.dcp import ALIAS, IDENTIFY, MULTICAST, NAME, PERMANENT, SET, dcp_frame, encoded
from tests.support.wire.profinet import DEVICE_MAC

SWITCH = Station(Identity(bytes.fromhex("020000000009"), 1, 1, "switch", "S"), "switch", port="port-003")
PLACE = b"port-003.switch"
"""The alias of what is plugged into port 3 of the switch."""
SPEED = 0x1000


def ask(site: Plant, frame: bytes) -> list[ProfinetDCP]:
    """Send a DCP request; the answers that scapy reads."""
    sent = len(site.frames)
    site.port.arrive(None, frame)
    site.run(50 * MS)
    return [Ether(data)[ProfinetDCP] for _, data in site.frames[sent:] if data[6:12] == DEVICE_MAC and data[14] == 0xFE]


def identify(site: Plant, option: tuple[int, int], content: bytes) -> list[ProfinetDCP]:
    return ask(site, dcp_frame(*IDENTIFY, encoded(option, content), MULTICAST, delay=1))


def test_a_replaced_gateway_is_named_by_its_neighbour_and_starts_nothing(tmp_path: Path) -> None:
    config = configuration(axis(1), tmp_path / "old.json")
    with plant(config) as site:
        site.connect()
        site.enable(1, SPEED)
    spare = config.model_copy(
        update={
            "store": tmp_path / "spare.json",
            "transport": config.transport.model_copy(update={"station_name": ""}),
        }
    )
    with plant(spare) as site:
        site.port.arrive(None, lldp.encode(SWITCH))
        assert identify(site, NAME, b"press-1") == [], "nobody has the name of the project"
        assert identify(site, ALIAS, b"port-002.switch") == []
        (found,) = identify(site, ALIAS, PLACE)
        (name,) = [block for block in found.dcp_blocks if (block.option, block.sub_option) == NAME]
        assert name.name_of_station == b"", "in the state of delivery: the controller may name it"
        content = encoded(NAME, PERMANENT.to_bytes(2, "big") + b"press-1")
        (answer,) = ask(site, dcp_frame(*SET, content, DEVICE_MAC.hex(":")))
        assert bytes(answer)[10:17] == bytes.fromhex("0504 0003 0202 00")
        site.connect()
        assert site.port.address.address == site.plc.learned.ip.address
        # The program of the PLC has gone on: ON and a speed from the first frame.
        model = drive_of(site.daemon).model
        site.set(1, ON, SPEED)
        for _ in range(100):
            site.run(10 * MS)
            assert model.state is not State.OPERATION_ENABLED
            assert not model.velocity_actual
        site.enable(1, SPEED)
        site.run(SECOND)
        assert abs(model.velocity_actual) > 100
    with plant(spare) as site:
        assert site.link.device.station.name == "press-1", "kept over a power cycle"
