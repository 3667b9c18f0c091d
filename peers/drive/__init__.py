"""A realistic CiA 402 drive: pure model, CANopen node, and a thread on any python-can bus."""

from pdgw.peers.drive.model import DriveModel, Machine
from pdgw.peers.drive.node import SimulatedDrive, SimulatedDriveNode

__all__ = ["DriveModel", "Machine", "SimulatedDrive", "SimulatedDriveNode"]
