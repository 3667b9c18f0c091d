"""The simulated CiA 402 drive: shapes, CANopen node, node on any python-can bus."""

from pdgw.peers.drive.drive import SimulatedDrive, SimulatedDriveNode
from pdgw.peers.drive.model.latency import Latency
from pdgw.peers.drive.model.model import DriveModel
from pdgw.peers.drive.model.shapes import ENGEL, LINEAR_AXIS, MACHINES, ROTARY_AXIS, SHAPES, Machine, Shape, shape

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
