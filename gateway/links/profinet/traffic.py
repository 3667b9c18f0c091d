"""What the link waits for, and what the device sends and receives beside the cyclic frames: DCP, LLDP and RPC."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Final

from pdgw.ds301.counters import Counters
from pdgw.ds301.loop.loop import Loop, Mailbox, Task, Timer
from pdgw.gateway.base.udp import Address
from pdgw.gateway.links.link import AT_ONCE, FrameRecorder
from pdgw.gateway.links.profinet.ethernet import EthernetPort
from pdgw.profinet.connection.cpm import Verdict
from pdgw.profinet.device import ProfinetDevice
from pdgw.profinet.rpc.dcerpc import ACYCLIC_PORT
from pdgw.profinet.station import Station

_WAITING: Final = 64
"""Datagrams that may wait for the task; of more the oldest are lost, and their senders ask again."""


class Running:
    """The link from its start to its end: what it waits for."""

    def __init__(self, exchange: Callable[[], None], calls: Task, watch: Timer) -> None:
        self.exchange = exchange
        """Take what has come from the controller, and answer it."""
        self.timer: Timer | None = None
        """When the device has something to do."""
        self.watch = watch
        """When the diagnosis is due."""
        self._calls = calls

    def end(self) -> None:
        """Wait for nothing any more."""
        self._calls.kill()
        self.watch.cancel()
        if self.timer is not None:
            self.timer.cancel()


class Traffic:
    """Frames and datagrams of one device. ``calls`` are the datagrams that wait for the task that serves them."""

    def __init__(self, port: EthernetPort, device: ProfinetDevice, station: Station, loop: Loop) -> None:
        self._port = port
        self._device = device
        self._station = station
        self.calls: Mailbox[tuple[bytes, Address]] = Mailbox(loop, _WAITING)

    def count(self, counters: Counters, watchdog_expiries: Callable[[], int]) -> None:
        """Register the counters of the link."""
        add, device = partial(counters.add, "link"), self._device
        for verdict in Verdict:
            add(verdict.name.lower(), "frames", verdict.value, partial(device.cm.cyclic.received.__getitem__, verdict))
        add("foreign", "frames", "unknown relationship", lambda: device.foreign)
        add("watchdog_expiries", "times", "no frame in time while connected", watchdog_expiries)
        add("connects_refused", "times", "Connect refused", lambda: device.cm.refusals)
        add("dcp_refused", "blocks", "DCP Set rejected", lambda: device.dcp.refused)
        add("errors", "frames", "send or receive failed", lambda: self._port.errors)
        add("sent", "frames", "cyclic frames to the controller", lambda: device.cm.cyclic.sent)
        add("missed", "frames", "cyclic frames not sent in their cycle", lambda: device.cm.cyclic.missed)

    @property
    def _own(self) -> Address:
        """Where calls are received."""
        return str(self._station.ip.address), ACYCLIC_PORT

    def receive(self, recorder: FrameRecorder | None, now: int) -> None:
        """Receive what waits, bounded in each turn, so that a flood delays no cycle."""
        for _ in range(AT_ONCE // 4):
            frame = self._port.receive_other()
            datagram = self._port.receive_datagram()
            if frame is None and datagram is None:
                break
            if frame is not None:
                self._device.on_frame(frame, now)
                if recorder is not None:
                    recorder.ethernet(frame)
            if datagram is not None:
                self.calls.put(datagram)
                if recorder is not None:
                    recorder.datagram(datagram[1], self._own, datagram[0])

    def send(self, recorder: FrameRecorder | None) -> None:
        """Send what the device has to send."""
        port = self._port
        for address, data in self._device.outgoing():
            if address is None:
                port.send(data)
                if recorder is not None:
                    recorder.ethernet(bytes(data))
            else:
                port.send_datagram(bytes(data), address)
                if recorder is not None:
                    recorder.datagram(self._own, address, bytes(data))
