"""The touch probe of a drive, and an encoder of its own as G1 or G2 of an axis.

Touch probe of a drive, by SDO: arm it, poll it, read the latched value (``Outputs.probe``). The drive latches the position
itself, so the time of reading does not matter. Source: CiA 402-2, 60B8h to 60BDh. An encoder of its own as G1 or G2 of an
axis: references and freshness for the axis machine, presets for the encoder.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from typing import Final

from pdgw.base.durations import MS
from pdgw.ds301.aborts import NOT_THERE, SdoAbortedError, abort_text
from pdgw.dsp402.drive import touch_probe
from pdgw.dsp402.drive.client import DriveClient
from pdgw.gateway.axis.machine import AxisMachine
from pdgw.gateway.axis.values import News, PresetAnswer, ProbeAnswer, ProbeWish, SdoWrite
from pdgw.gateway.objects.drive_object import log
from pdgw.gateway.objects.encoder import EncoderObject

_POLL_NS: Final = 20 * MS
_FUNCTION_BYTES = 2


class ProbeReader:
    """Executes the probe requests of one axis; answers are added to ``news``."""

    def __init__(self, drive: DriveClient, news: deque[News]) -> None:
        self._drive = drive
        self._news = news
        self._wish: ProbeWish | None = None
        self._job: Future[None] | None = None
        self._due = 0
        self._ended = True
        """Whether there is nothing to read: answered, or no request."""

    def step(self, wish: ProbeWish | None, now: int) -> bool:
        """Run one cycle; another request object is a new request. False: nothing to do without a request."""
        if self._job is not None:
            if not self._job.done():
                return True
            error, self._job = self._job.exception(), None
            if error is not None:
                self._failed(error)
        if wish is not self._wish:
            armed = self._wish is not None
            self._wish, self._ended = wish, wish is None
            if wish is not None or armed:
                function = touch_probe.function(wish.edges, zero_pulse=wish.zero_pulse) if wish is not None else 0
                self._job = self._drive.submit(lambda drive: _arm(drive, function))
                self._due = now + _POLL_NS
        elif wish is not None and not self._ended and now >= self._due:
            self._due = now + _POLL_NS
            self._job = self._drive.submit(lambda drive: self._poll(drive, wish))
        return self._job is not None

    def _poll(self, drive: DriveClient, wish: ProbeWish) -> None:
        status = drive.sdo.read_number(touch_probe.STATUS)
        stored = [edge for edge in wish.edges if status & touch_probe.stored_bit(edge)]
        if stored:
            self._ended = True
            read = {edge: drive.sdo.read_number(touch_probe.POSITIONS[edge], signed=True) for edge in stored}
            self._news.append(ProbeAnswer(wish, read))
        elif not touch_probe.enabled_bits(status):
            self._ended = True
            text = f"60B9h = {status:04X}h: the drive has disabled the touch probe"
            self._news.append(ProbeAnswer(wish, {}, text))

    def _failed(self, error: BaseException) -> None:
        wish, self._ended = self._wish, True
        if wish is None:
            return  # the probe could not be disabled: no client waits for the answer
        if isinstance(error, SdoAbortedError):
            self._news.append(ProbeAnswer(wish, {}, abort_text(error.code), error.code not in NOT_THERE))
        else:
            # No answer, or one that canopen unpacks without checks: it must not end the exchange.
            log.warning("touch probe of node %d: %r", self._drive.settings.node_id, error)
            self._news.append(ProbeAnswer(wish, {}, str(error)))


def _arm(drive: DriveClient, function: int) -> None:
    """Disable first, which clears the stored positions."""
    drive.sdo.write(touch_probe.FUNCTION, 0, bytes(_FUNCTION_BYTES))
    if function:
        drive.sdo.write(touch_probe.FUNCTION, 0, function.to_bytes(_FUNCTION_BYTES, "little"))


class SensorLink:
    """``place``: 0 for G1, 1 for G2. ``step`` precedes each step of the machine."""

    def __init__(self, encoder: EncoderObject, place: int, do_id: int) -> None:
        self.encoder = encoder
        self._place = place
        self._do_id = do_id
        self._parameters: object = None
        self._preset: SdoWrite | None = None
        self._future: Future[None] | None = None

    def connect(self, machine: AxisMachine) -> None:
        """The encoder is a sensor of this machine from now on."""
        machine.inputs.encoders[self._place] = self.encoder.input
        self._parameters = None
        machine.set_references(self._place, None)

    def step(self, machine: AxisMachine, now: int, note: Callable[[str, object], None]) -> None:
        """Before a step of the machine. ``note`` takes what the machine is given."""
        encoder, place = self.encoder, self._place
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
