"""Recordings of both buses made in virtual time: a rig whose PLC frames, answers and CAN frames are kept."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from pdgw.base.durations import MS
from pdgw.ds301.communication import NmtCommand
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.objects import DRIVE_OBJECTS
from pdgw.gateway.links.cyclic import CyclicEndpoint
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.profidrive.frame import ETHERTYPE
from pdgw.tools.decoder.frames.engine import Settings, given_axes
from pdgw.tools.recording.recordings import Known, Opening, look_ahead
from tests.support.axis.rig import NODE, Rig
from tests.support.drives.drive_types import REFERENCE_OBJECTS
from tests.support.readers import captures

CYCLE_NS = 4 * MS
BEGIN_NS = captures.BEGIN_NS
_REFRESH_NS = 100 * MS
_PLC = ("127.0.0.1", 34962)
MACS = bytes.fromhex("020000000002020000000001") + struct.pack(">H", ETHERTYPE)
_COMMAND_NS, _ANSWER_NS, _DRIVE_NS, _SDO_NS = 100_000, 300_000, 600_000, 900_000
"""What the gateway needs for its RPDOs and for its answer, and when the drive has answered the RPDOs and an SDO."""

_SENT = {0x200 + NODE, 0x300 + NODE, 0x400 + NODE, 0x500 + NODE, 0x240 + NODE}
_SDO = {0x580, 0x600}

PlcFrame = tuple[int, bytes]
CanFrame = tuple[int, int, bytes]


@dataclass
class Frames:
    """The frames of both buses in virtual nanoseconds; tests change them before they are written."""

    plc: list[PlcFrame] = field(default_factory=list)
    answers: list[PlcFrame] = field(default_factory=list)
    can: list[CanFrame] = field(default_factory=list)

    def write(self, folder: Path, *, offset_ns: int = 0, jitter_ns: int = 0) -> list[str]:
        """plc.pcap and can.log; the CAN clock is ahead by ``offset_ns``, CAN times are off by up to ``jitter_ns``."""
        noise = random.Random(1)
        both = sorted([*self.plc, *self.answers], key=lambda item: item[0])
        packets = [(BEGIN_NS + now, captures.ETHERNET, MACS + data) for now, data in both]
        (folder / "plc.pcap").write_bytes(captures.pcap(packets, nanoseconds=True))
        lines = []
        last = {True: 0, False: 0}
        for now, cob_id, data in sorted(self.can, key=lambda item: item[0]):
            # What the gateway sends and what it receives stay in their order, whatever the recorder does to the times.
            sent = cob_id == 0 or cob_id in _SENT
            if cob_id & ~0x7F in _SDO:  # a request recorded after its response would be another recording
                lines.append((now, cob_id, data))
                continue
            last[sent] = max(last[sent], now + noise.randint(-jitter_ns, jitter_ns))
            lines.append((last[sent], cob_id, data))
        text = ""
        for now, cob_id, data in sorted(lines, key=lambda item: item[0]):
            seconds, rest = divmod(BEGIN_NS + now + offset_ns, 10**9)
            text += f"({seconds}.{rest // 1000:06d}) can0 {cob_id:03X}#{data.hex().upper()}\n"
        (folder / "can.log").write_text(text)
        return [str(folder / "plc.pcap"), str(folder / "can.log")]

    def change_can(self, cob_id: int, number: int, change: Callable[[bytes], bytes | None]) -> int:
        """Change one frame of an identifier (None removes it); returns its time."""
        position = [i for i, frame in enumerate(self.can) if frame[1] == cob_id][number]
        now, _, data = self.can.pop(position)
        changed = change(data)
        if changed is not None:
            self.can.insert(position, (now, cob_id, changed))
        return now


class RecordedRig(Rig):
    """A rig with the gateway's endpoint in front and a recorder beside it. ``plc`` is the PLC's endpoint."""

    def __init__(self, number: int, **settings: object) -> None:
        self.frames = Frames()
        self._later = 0
        super().__init__(number, **settings)
        telegram = self.stepper.telegram
        self.number = number
        self.settings = self.stepper.settings
        self.plc = PlcEndpoint([telegram], CYCLE_NS)
        self.endpoint = CyclicEndpoint([telegram], cycle_ns=CYCLE_NS)
        self.sdo_delay = 2
        self.gateway_stops = False
        self._sent_at: dict[int, int] = {}

    # -- the drive's side ---------------------------------------------------------------------------------------------

    def _can(self, cob_id: int, data: bytes, later: int = 0) -> None:
        self.frames.can.append((self.now + later, cob_id, bytes(data)))

    def _transmitted(self, can_id: int, data: bytes) -> None:
        self._can(can_id, data, self._later)
        super()._transmitted(can_id, data)

    def _configure(self, mode: Mode | None) -> None:
        self._can(0, bytes((NmtCommand.ENTER_PRE_OPERATIONAL, NODE)))
        self.node.set_data(0x6098, 0, b"\x23", check_writable=True)
        for index, subindex in [*((i, s) for _, i, s in REFERENCE_OBJECTS), (0x6098, 0)]:
            request = struct.pack("<BHB4x", 0x40, index, subindex)
            self._can(0x600 + NODE, request)
            self.node.receive(0x600 + NODE, request, self.now)
        super()._configure(mode)
        self._can(0, bytes((NmtCommand.START, NODE)), -2 * MS)

    def _send(self) -> None:
        command = self.stepper.command
        for pdo in sorted(self.layout.rpdos, key=lambda item: -item.number):
            data = pdo.pack(command)
            if self._sent.get(pdo.number) != data or self.now - self._sent_at.get(pdo.number, 0) >= _REFRESH_NS:
                self._can(pdo.cob_id(NODE), data, _COMMAND_NS)
                self._sent_at[pdo.number] = self.now
        self._later = _DRIVE_NS
        super()._send()
        self._later = 0

    def _serve_sdo(self) -> None:
        request = self.stepper.sdo_request
        super()._serve_sdo()
        if request is None or self.stepper.sdo_request is not None:
            return
        for item in request:
            size = DRIVE_OBJECTS.entry(item.index, item.subindex).type.bits // 8
            head = struct.pack("<HB", item.index, item.subindex)
            value = item.value.to_bytes(4, "little", signed=item.value < 0)
            self._can(0x600 + NODE, bytes((0x23 | (4 - size) << 2,)) + head + value, _SDO_NS)
            aborted = bytes((0x80,)) + head + bytes.fromhex("22000008")
            self._can(0x580 + NODE, aborted if self.sdo_error else bytes((0x60,)) + head + bytes(4), _SDO_NS)
            if self.sdo_error:
                return

    # -- the PLC's side -----------------------------------------------------------------------------------------------

    def step(self, cycles: int = 1, *, plc: bool = True) -> dict[str, int]:
        for _ in range(cycles):
            self._advance(4)
            if plc:
                self.plc.set(0, self.values)
                frame = bytes(self.plc.build())
                self.frames.plc.append((self.now, frame))
                self.endpoint.receive(frame, _PLC, self.now)
            self.endpoint.poll(self.now)
            self.stepper.machine.inputs.gateway_stops = self.gateway_stops
            actuals = self.stepper.step(self.endpoint.setpoints[0], self.feedback, self.connected_drive, self.now)
            if self.gateway_stops:
                self.endpoint.lose_setpoints()
            self.actuals = self.stepper.telegram.actuals.as_dict(actuals)
            self._send()
            self._serve_sdo()
            answer = bytes(self.endpoint.build([actuals], [self.connected_drive], self.now))
            self.plc.receive(answer, self.now)
            self.frames.answers.append((self.now + _ANSWER_NS, answer))
        return self.actuals

    def pause(self, milliseconds: int) -> None:
        """Let time pass without events."""
        self._advance(milliseconds)

    def stw(self, word: int, cycles: int = 5) -> None:
        """Another control word, and some cycles with it."""
        self.values[self.stepper.telegram.setpoints.names[0]] = word
        self.step(cycles)

    # -- what was recorded --------------------------------------------------------------------------------------------

    @property
    def known(self) -> Known:
        """Settings of the command line."""
        return known(self.number)

    def open(self, folder: Path, *, clock_ns: int = 0, jitter_ns: int = 0) -> Opening:
        """Write the captures and open them as ``pdgw timeline`` does."""
        files = self.frames.write(folder, offset_ns=clock_ns, jitter_ns=jitter_ns)
        return look_ahead(files, self.known, None, lambda _: None)


def known(number: int) -> Known:
    """One axis, on the rig's node."""
    axis = given_axes([number])[0]
    return Known(Settings([type(axis)(axis.do_id, axis.telegram, NODE)]), CYCLE_NS, 3)


def speed(number: int = 1, **settings: object) -> RecordedRig:
    """Start, speed, OFF1 ramp, start again, quick stop."""
    rig = RecordedRig(number, **settings)
    rig.step(5)
    rig.enable(0x047E)
    name = rig.stepper.telegram.setpoints.names[1]
    rig.values[name] = 0x1000 if number == 1 else 0x10000000
    rig.step(60)
    rig.stw(0x047E, 80)
    rig.stw(0x047F, 20)
    rig.stw(0x047B, 60)
    return rig


def positioning(sdo_delay: int | None = None) -> RecordedRig:
    """Homing, a relative task on the fly, intermediate stop and resume, reject."""
    rig = RecordedRig(9)
    if sdo_delay is not None:
        rig.sdo_delay = sdo_delay
    rig.step(5)
    rig.enable()
    rig.values["SATZANW"] = 0x8000 | 35
    rig.stw(0x0C3F, 30)
    rig.stw(0x043F)
    rig.values |= {
        "MDI_TARPOS": 0x08000000,
        "MDI_VELOCITY": 0x40000000,
        "MDI_ACC": 0x4000,
        "MDI_DEC": 0x4000,
        "MDI_MOD": 1,
    }
    rig.stw(0x047F, 30)
    rig.values |= {"MDI_TARPOS": 0x04000000, "MDI_MOD": 0}
    rig.stw(0x043F, 10)
    rig.stw(0x047F, 20)
    rig.stw(0x045F, 40)
    rig.stw(0x047F, 60)
    rig.stw(0x046F, 40)
    return rig


def transparent() -> RecordedRig:
    """Velocity mode over telegram 100."""
    rig = RecordedRig(100)
    for word in (0, 6, 7, 15):
        rig.stw(word)
    rig.values |= {"Modes of Operation": 3, "Target Velocity": 2000, "Profile Acceleration": 300}
    rig.step(60)
    rig.stw(0, 20)
    return rig


RIGS: dict[str, Callable[[], RecordedRig]] = {
    "telegram 1": speed,
    "telegram 2": lambda: speed(2),
    "telegram 9": positioning,
    "telegram 100": transparent,
}
