"""The simulated CiA 406 encoder: motions, model, CANopen node, thread on any python-can bus."""

from pdgw.peers.encoder.encoder import SimulatedEncoder, SimulatedEncoderNode
from pdgw.peers.encoder.encoder_model import EncoderModel
from pdgw.peers.encoder.motion import Motion

__all__ = ["EncoderModel", "Motion", "SimulatedEncoder", "SimulatedEncoderNode"]
