"""A realistic CiA 402 drive: pure model, CANopen node, and a thread on any python-can bus."""

from dsp402.simulator.model import DriveModel, Machine
from dsp402.simulator.node import SimulatedDrive, SimulatedDriveNode

__all__ = ["DriveModel", "Machine", "SimulatedDrive", "SimulatedDriveNode"]
