"""A realistic CiA 402 drive: pure model in several shapes, CANopen node, and a node on any python-can bus."""

from pdgw.peers.drive.machine import LINEAR, MACHINES, ROTARY, Machine
from pdgw.peers.drive.model import DriveModel
from pdgw.peers.drive.node import SimulatedDrive, SimulatedDriveNode
from pdgw.peers.drive.shapes import ENGEL, SHAPES, Shape, shape

__all__ = [
    "ENGEL",
    "LINEAR",
    "MACHINES",
    "ROTARY",
    "SHAPES",
    "DriveModel",
    "Machine",
    "Shape",
    "SimulatedDrive",
    "SimulatedDriveNode",
    "shape",
]
