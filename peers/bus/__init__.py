"""A CAN bus between processes of one machine, without a kernel module.

A hub forwards Linux's ``struct can_frame`` between members over connected UDP sockets on loopback. ``LoopbackBus`` is a
member as a python-can interface, named ``pdgw-bus``. Its socket reads and writes the same data as SocketCAN's, so that a
gateway runs the same code on it. Arbitration, acknowledgements, bit times and error frames are not simulated.
"""

from pdgw.peers.bus.hub import Hub
from pdgw.peers.bus.interface import INTERFACE, LoopbackBus
from pdgw.peers.bus.served import ServedBus

__all__ = ["INTERFACE", "Hub", "LoopbackBus", "ServedBus"]
