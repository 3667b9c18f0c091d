"""What the device sends and receives beside the cyclic frames: DCP, LLDP and RPC, with its recording."""

from __future__ import annotations

from typing import Final

from pdgw.ds301.loop.loop import Loop, Mailbox
from pdgw.gateway.base.udp import Address
from pdgw.gateway.links.link import AT_ONCE, FrameRecorder
from pdgw.gateway.links.profinet.ethernet import EthernetPort
from pdgw.profinet.device import ProfinetDevice
from pdgw.profinet.rpc.dcerpc import ACYCLIC_PORT
from pdgw.profinet.station import Station

_WAITING: Final = 64
"""Datagrams that may wait for the task; of more the oldest are lost, and their senders ask again."""


class Traffic:
    """Frames and datagrams of one device. ``calls`` are the datagrams that wait for the task that serves them."""

    def __init__(self, port: EthernetPort, device: ProfinetDevice, station: Station, loop: Loop) -> None:
        self._port = port
        self._device = device
        self._station = station
        self.calls: Mailbox[tuple[bytes, Address]] = Mailbox(loop, _WAITING)

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
