"""The simulated CiA 406 encoder: motions, model, CANopen node, thread on any python-can bus."""

from pdgw.peers.encoder.model import EncoderModel
from pdgw.peers.encoder.motion import Motion
from pdgw.peers.encoder.node import SimulatedEncoder, SimulatedEncoderNode

__all__ = ["EncoderModel", "Motion", "SimulatedEncoder", "SimulatedEncoderNode"]
