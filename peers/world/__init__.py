"""A world in virtual time: CAN buses, IP network, devices and a PLC around the gateway. One seed gives one run, bit for bit."""

from pdgw.peers.world.can_bus import Member, SimulatedCan
from pdgw.peers.world.gateway import Gateway, Plc, SimulatedDevice
from pdgw.peers.world.udp import Conditions, SimulatedNetwork, SimulatedUdpPort
from pdgw.peers.world.world import World, WorldChannel

__all__ = [
    "Conditions",
    "Gateway",
    "Member",
    "Plc",
    "SimulatedCan",
    "SimulatedDevice",
    "SimulatedNetwork",
    "SimulatedUdpPort",
    "World",
    "WorldChannel",
]
