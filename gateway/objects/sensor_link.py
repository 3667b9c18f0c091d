"""An encoder of its own as G1 or G2 of an axis: references and freshness for the axis machine, presets for the encoder."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future

from pdgw.gateway.axis.machine import AxisMachine
from pdgw.gateway.axis.values import PresetAnswer, SdoWrite
from pdgw.gateway.objects.drive_object import log
from pdgw.gateway.objects.encoder import EncoderObject
from pdgw.profidrive.sensor_format import SensorFormat


class SensorLink:
    """``place``: 0 for G1, 1 for G2. ``step`` precedes each step of the machine."""

    def __init__(self, encoder: EncoderObject, place: int, do_id: int) -> None:
        self._encoder = encoder
        self._place = place
        self._do_id = do_id
        self._parameters: object = None
        self._preset: SdoWrite | None = None
        self._future: Future[None] | None = None

    @property
    def sensor_format(self) -> SensorFormat:
        """P979: what the encoder is."""
        return self._encoder.sensor_format

    def connect(self, machine: AxisMachine) -> None:
        """The encoder is a sensor of this machine from now on."""
        machine.inputs.encoders[self._place] = self._encoder.input
        self._parameters = None
        machine.set_references(self._place, None)

    def step(self, machine: AxisMachine, now: int, note: Callable[[str, object], None]) -> None:
        """Before a step of the machine. ``note`` takes what the machine is given."""
        encoder, place = self._encoder, self._place
        if encoder.client.parameters is not self._parameters:
            self._parameters = encoder.client.parameters
            machine.set_references(place, references := encoder.references)
            note("references", (place, references))
        machine.inputs.encoders_ok[place] = encoder.client.refresh(now)
        preset, future = machine.outputs.presets[place], self._future
        if preset is not self._preset:
            self._preset = preset
            if future is not None:
                future.cancel()
            self._future = None if preset is None else encoder.submit_write(preset)
        elif preset is not None and future is not None and future.done():
            self._future = None
            error = future.exception()
            if error is not None:
                log.warning("axis %d: preset of G%d rejected: %s", self._do_id, place + 1, error)
            machine.inputs.news.append(PresetAnswer(preset, None if error is None else str(error)))
