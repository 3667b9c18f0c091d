"""A realistic CiA 406 encoder: motions, pure model, CANopen node, and a thread on any python-can bus."""

from dsp406.simulator.model import EncoderModel
from dsp406.simulator.motion import Motion
from dsp406.simulator.node import SimulatedEncoder, SimulatedEncoderNode

__all__ = ["EncoderModel", "Motion", "SimulatedEncoder", "SimulatedEncoderNode"]
