"""The simulated encoder on a bus: the CANopen node of the model, and its commands."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import can

from pdgw.ds301 import communication as com
from pdgw.ds301.aborts import Abort, SdoAbortedError
from pdgw.ds301.bus.port import CanPort
from pdgw.ds301.configuration import EVENT_DRIVEN_PROFILE
from pdgw.ds301.loop.loop import Loop
from pdgw.ds301.objects import Entry
from pdgw.dsp406.device import encoder_objects
from pdgw.dsp406.kinds import OPERATING_RESERVED, ROTARY, Dsp406Error, EncoderDevice
from pdgw.dsp406.objects import CYCLIC_TIMER, OPERATING_PARAMETERS, PRESET, PRESET_MULTI_SENSOR
from pdgw.peers.encoder.encoder_model import ENCODER_HABITS, EncoderModel
from pdgw.peers.encoder.motion import Follower, Motion
from pdgw.peers.node.behaviour import NONE, HabitValues
from pdgw.peers.node.device import Value
from pdgw.peers.node.node import SendFunction, SimulatedNode
from pdgw.peers.node.running import RunningNode


class SimulatedEncoderNode(SimulatedNode):
    """CANopen encoder, sans-I/O: ``receive``, ``receive_remote`` and ``poll`` with times, frames to ``send``.

    ``motions``: one for each channel in order; other channels are at standstill. ``operating_time``: as for
    ``EncoderModel``.
    """

    catalogue = ENCODER_HABITS

    def __init__(
        self,
        node_id: int,
        send: SendFunction,
        *,
        device: EncoderDevice = ROTARY,
        motions: Sequence[Motion] = (),
        serial_number: int = 1,
        operating_time: int | None = 0,
        habits: HabitValues = NONE,
    ) -> None:
        self.model = EncoderModel(device, self._object, motions, operating_time)
        super().__init__(node_id, encoder_objects(device, serial_number), self.model, send, habits)

    def _object(self, index: int, subindex: int) -> int:
        return int(self.values[index, subindex])

    def on_poll(self, now: int) -> None:
        self.model.advance(now)
        self.send_emergencies(self.model.emcy)

    def next_change(self, now: int) -> int | None:
        return self.model.next_change()

    def on_foreign_frame(self, can_id: int, data: bytes) -> bool:
        followers = [c.motion for c in self.model.channels.values() if isinstance(c.motion, Follower)]
        for follower in followers:
            follower.receive(can_id, data)
        return bool(followers)

    def on_written(self, entry: Entry, value: Value) -> None:
        if entry.index == OPERATING_PARAMETERS and int(value) & OPERATING_RESERVED:
            raise SdoAbortedError(Abort.VALUE_RANGE)
        if entry.index in {PRESET, PRESET_MULTI_SENSOR}:
            self.model.advance(self.now)
            try:
                self.model.preset(int(value), entry.subindex or 1)
            except Dsp406Error:
                raise SdoAbortedError(Abort.VALUE_TOO_HIGH) from None

    def write(self, entry: Entry, value: Value) -> None:
        super().write(entry, value)
        if entry.index == CYCLIC_TIMER:
            self.pdos.map()
        elif entry.index == com.RESTORE_PARAMETERS:
            self.model.restore_defaults()
        elif entry.index >= OPERATING_PARAMETERS:
            self.on_poll(self.now)

    def event_timer(self, index: int) -> int:
        """The cyclic timer 6200h applies to all asynchronous PDOs."""
        return int(self.values[CYCLIC_TIMER, 0])

    def sent_on_change(self, transmission_type: int) -> bool:
        """With type 254 only the cyclic timer is an event."""
        return self.changes_are_events and transmission_type == EVENT_DRIVEN_PROFILE

    def storable(self, entry: Entry) -> bool:
        """Cam enable and polarity are stored, too, although PDOs can contain them."""
        return True

    def on_consumer_expired(self, producer: int) -> None:
        self.send_emcy(0x8130, 0x11)

    def on_reset(self) -> None:
        self.model.reset()


class SimulatedEncoder(RunningNode[SimulatedEncoderNode]):
    """A ``SimulatedEncoderNode``, which has the ``options``, running on a bus; see ``RunningNode``."""

    def __init__(self, bus: can.BusABC | CanPort, node_id: int, *, loop: Loop | None = None, **options: Any) -> None:
        super().__init__(bus, lambda send: SimulatedEncoderNode(node_id, send, **options), loop)

    @property
    def model(self) -> EncoderModel:
        return self.node.model

    def inject(self, fault: int | str) -> None:
        """Raise a fault by name, see ``EncoderModel.inject``, or start a habit."""
        self.raise_fault(fault, lambda node: node.model.inject(fault))

    def clear(self, fault: str | None = None) -> None:
        """Remove one cause or all, and end its habit; see ``EncoderModel.clear``."""
        self.do(lambda node: node.end_fault(fault))
        self.do(lambda node: node.model.clear(fault))

    def set_motion(self, motion: Motion, channel: int = 1) -> None:
        """Set another motion; see ``EncoderModel.set_motion``."""
        self.do(lambda node: node.model.set_motion(motion, channel))
