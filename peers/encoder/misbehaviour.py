"""Faults of a simulated encoder in addition to those of any CANopen node: causes of alarms, warnings and EMCYs.

Source: ``dsp406.faults``; each of its causes is a fault of the same name. See ``peers.node.misbehaviour``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

from pdgw.dsp406.faults import ENCODER_FAULTS, EncoderFault
from pdgw.peers.node.faults import NODE_MISBEHAVIOURS
from pdgw.peers.node.misbehaviour import Misbehaviour, catalogue

if TYPE_CHECKING:
    from pdgw.peers.encoder.model import EncoderModel


@dataclass(kw_only=True, eq=False)
class EncoderMisbehaviour(Misbehaviour):
    """A cause in the encoder, present until the fault is removed."""

    @property
    def model(self) -> EncoderModel:
        """The model of the node's encoder."""
        return cast("EncoderModel", self.node.image)

    def begin(self) -> None:
        self.model.inject(self.name)

    def end(self) -> None:
        self.model.clear(self.name)


def _of(fault: EncoderFault) -> type[EncoderMisbehaviour]:
    name = "".join(part.title() for part in fault.name.split("-"))
    return type(name, (EncoderMisbehaviour,), {"name": fault.name, "__doc__": fault.meaning})


ENCODER_MISBEHAVIOURS = catalogue(NODE_MISBEHAVIOURS.values(), map(_of, ENCODER_FAULTS.values()))
"""All faults of a simulated encoder."""
