"""A realistic CiA 402 drive: pure model in several shapes, CANopen node, and a node on any python-can bus."""

from pdgw.peers.drive.latency import Latency
from pdgw.peers.drive.machine import LINEAR_AXIS, MACHINES, ROTARY_AXIS, Machine
from pdgw.peers.drive.model import DriveModel
from pdgw.peers.drive.node import SimulatedDrive, SimulatedDriveNode
from pdgw.peers.drive.shapes import ENGEL, SHAPES, Shape, shape

__all__ = [
    "ENGEL",
    "LINEAR_AXIS",
    "MACHINES",
    "ROTARY_AXIS",
    "SHAPES",
    "DriveModel",
    "Latency",
    "Machine",
    "Shape",
    "SimulatedDrive",
    "SimulatedDriveNode",
    "shape",
]
