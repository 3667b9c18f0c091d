"""The flight recorder of a daemon: hands every cycle and every CAN frame to a ring file."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pdgw.dsp402.drive.images import DriveCommand, DriveFeedback
from pdgw.durations import SECOND, US
from pdgw.gateway.axis.encoder_machine import EncoderInputs
from pdgw.gateway.axis.values import Inputs
from pdgw.gateway.configuration.file import config_text
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.objects.axis import Axis
from pdgw.gateway.objects.drive_object import DriveObject
from pdgw.gateway.objects.encoder import EncoderObject
from pdgw.gateway.reasons import Reason
from pdgw.gateway.trace.layout import CycleFlag, ObjectFlag, RingLayout, TracedObject
from pdgw.gateway.trace.writer import RingFile

if TYPE_CHECKING:
    from pdgw.gateway.daemon import Daemon

log = logging.getLogger("gateway")

_MEGABYTE: Final = 1 << 20
_ANCHOR_NS: Final = SECOND
"""Interval at which the ring gets the wall clock and the address of the PLC."""
_LONGEST_US: Final = 0xFFFF
_OTHER_FRAMES: Final = 200
"""CAN frames a second and bus beside the PDOs: heartbeats, SDOs."""
_FRESH: Final = int(CycleFlag.FRESH)
_CONNECTED: Final = int(CycleFlag.CONNECTED)
_ANSWERED: Final = int(CycleFlag.ANSWERED)
_SETPOINTS: Final = int(ObjectFlag.SETPOINTS)
_GOOD: Final = int(ObjectFlag.GOOD)
_ACTIVE: Final = int(ObjectFlag.ACTIVE_FAULT)
_NO_FEEDBACK: Final = DriveFeedback()
_NO_COMMAND: Final = DriveCommand()
"""Command of an encoder, whose values are in its telegram."""


class FlightRecorder:
    """Records until ``stop``; GatewayError from the constructor when the file cannot be made."""

    def __init__(self, daemon: Daemon, directory: Path, name: str) -> None:
        self._daemon = daemon
        self._directory = directory
        self._name = name
        self._lost = 0
        self._link = daemon.link
        self._ring: RingFile | None = None
        self._sources: list[_Source] = []
        self._anchor_due = 0
        self._token: object = None
        self._opening = False
        self._configuration = config_text(daemon.config)
        self._open(keep_previous=True)
        daemon.loop.counters.add("trace", "lost", "records", "not written to the flight recorder", lambda: self.lost)
        daemon.watch.listeners.append(self)
        daemon.recorder = self

    @property
    def path(self) -> Path | None:
        """The file, None while there is none."""
        return None if self._ring is None else self._ring.path

    @property
    def lost(self) -> int:
        """Records that were not written."""
        return self._lost + (self._ring.failures if self._ring is not None else 0)

    def start(self) -> None:
        """Nothing to do: it records from its construction on."""

    def stop(self) -> None:
        """End in order; the file stays."""
        ring = self._ring
        self._record_to(None)
        if ring is not None:
            ring.close()

    def _record_to(self, ring: RingFile | None) -> None:
        self._ring = ring
        for bus, network in enumerate(self._daemon.networks.values()):
            network.tap = None if ring is None else partial(ring.frame, bus)

    # -- the exchange -----------------------------------------------------------------------------------------------------

    def cycle(self, now: int, accepted: bool, answered: int) -> None:
        """CycleListener."""
        link, ring = self._link, self._ring
        if link.layout_token is not self._token:
            self._change()
            return
        if ring is None:
            return
        connected, received, sent = link.newest()
        flags = _FRESH if accepted else 0
        if connected:
            flags |= _CONNECTED
        response = 0
        if answered:
            flags |= _ANSWERED
            response = min((answered - now) // US, _LONGEST_US)
        values: list[Any] = [now, flags, len(received), len(sent), response, received, sent]
        for source in self._sources:
            outputs, feedback, faults = source.outputs, source.feedback, source.faults
            reason = outputs.reason
            values += (
                feedback.velocity_actual,
                feedback.position_actual,
                feedback.statusword,
                source.command.controlword,
                0 if reason is None else reason.code,
                (_SETPOINTS if source.inputs.setpoints is not None else 0)
                + (_GOOD if outputs.good else 0)
                + (_ACTIVE if faults.active else 0),
                faults.count & 0xFF,
            )
        ring.cycle(values)
        if now >= self._anchor_due:
            self._anchor(ring, now)

    def _anchor(self, ring: RingFile, now: int) -> None:
        self._anchor_due = now + _ANCHOR_NS
        if ring.truncated:
            log.warning("flight recorder: another program truncated %s; a new one is started", ring.path)
            self._reopen()
            return
        loop = self._daemon.loop
        ring.set_clock(int(loop.wall() * SECOND) - loop.now())
        peer = self._link.peer
        if peer is not None:
            ring.set_peer(peer)

    # -- the file ---------------------------------------------------------------------------------------------------------

    def _open(self, *, keep_previous: bool) -> None:
        self._token = self._link.layout_token
        layout = self._layout()
        limit = self._daemon.config.trace.megabytes * _MEGABYTE
        ring = RingFile(self._directory, layout, limit, keep_previous=keep_previous)
        self._sources = [_Source(item) for item in self._daemon.objects]
        self._anchor(ring, self._daemon.loop.now())
        self._record_to(ring)

    def _change(self) -> None:
        """The frames have another layout from now on: so has the ring. Making the file takes longer than a cycle may."""
        if self._opening:
            return  # the next cycle continues here
        self._token = self._link.layout_token
        if self._ring is None or _shape(self._ring.layout) != _shape(self._layout()):
            self._reopen()

    def _reopen(self) -> None:
        old = self._ring
        self._record_to(None)
        self._opening = True
        loop = self._daemon.loop

        def reopen() -> None:
            if old is not None:
                self._lost += old.failures
                old.close()
            try:
                self._open(keep_previous=False)
            except GatewayError as error:
                log.warning("%s", error)
            finally:
                self._opening = False

        loop.spawn(lambda: loop.result(loop.offload(reopen)), "flight recorder")

    def _layout(self) -> RingLayout:
        daemon = self._daemon
        config = daemon.config
        per_second = SECOND / daemon.cycle_ns
        pdos = sum(len(client.layout.rpdos) + len(client.layout.tpdos) for client in daemon.clients)
        frames = per_second * pdos + _OTHER_FRAMES * len(daemon.networks)
        seconds = config.trace.seconds
        return RingLayout(
            name=self._name,
            cycle_ns=daemon.cycle_ns,
            places=self._link.places(),
            objects=tuple(_traced(item) for item in daemon.objects),
            buses=tuple(daemon.networks),
            cycles=int(seconds * per_second),
            frames=int(seconds * frames),
            address=daemon.address,
            reasons=tuple(reason.name for reason in Reason),
            configuration=self._configuration,
        )


def _shape(layout: RingLayout) -> tuple[object, ...]:
    """Properties that require a new ring when they change."""
    return layout.places, layout.objects


def _traced(item: DriveObject) -> TracedObject:
    mapped: Sequence[str] = ()
    if isinstance(item, Axis):
        mapped = [name for pdo in item.drive.layout.tpdos for name in pdo.attributes]
    return TracedObject(
        item.do_id,
        item.kind,
        item.node_id,
        item.network.name,
        item.telegram.number,
        "velocity_actual" in mapped,
        "position_actual" in mapped,
    )


class _Source:
    """The objects with the values of a drive object, which are the same in each cycle."""

    def __init__(self, item: DriveObject) -> None:
        self.outputs = item.outputs
        self.faults = item.fault_log
        self.inputs: Inputs | EncoderInputs
        if isinstance(item, Axis):
            self.inputs, self.feedback, self.command = item.machine.inputs, item.drive.feedback, self.outputs.command
        else:
            assert isinstance(item, EncoderObject)
            self.inputs, self.feedback, self.command = item.machine.inputs, _NO_FEEDBACK, _NO_COMMAND
