"""The controller side of the static cyclic relationship, sans-I/O: the counterpart of ``gateway.links.cyclic``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from pdgw.base.durations import MS
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.frame import (
    COUNTER_UNIT_NS,
    FRAME_ID_TO_CONTROLLER,
    FRAME_ID_TO_DEVICE,
    IOPS_BAD,
    IOPS_GOOD,
    STATUS_DATA_VALID,
    STATUS_NORMAL,
    STATUS_PRIMARY,
    STATUS_STOP,
    TICK,
    TRAILER,
    CSduLayout,
    RtFrame,
    is_newer,
)
from pdgw.profidrive.telegrams import ApplicationMode, Direction, Telegram
from pdgw.profidrive.words import Bit

_WATCHDOG_NS = 200 * MS
_WATCHDOG_CYCLES = 10
_UNUSABLE = ("foreign", "malformed", "not valid", "not primary")
"""Counters of rejected datagrams."""


class PlcEndpoint:
    """Encodes setpoints of any number of axes, decodes actual values. Times are monotonic nanoseconds."""

    def __init__(self, telegrams: Sequence[Telegram], cycle_ns: int) -> None:
        self.telegrams = tuple(telegrams)
        self.setpoints: list[dict[str, int]] = [dict.fromkeys(t.setpoints.names, 0) for t in telegrams]
        self.actuals: list[dict[str, int] | None] = [None] * len(self.telegrams)
        """None until a valid frame arrives, while the gateway marks the values BAD (IOPS), and after its loss."""
        self.counters: Counter[str] = Counter()
        self._consumer = CSduLayout(telegrams, Direction.ACTUAL)
        self._provider = CSduLayout(telegrams, Direction.SETPOINT)
        self._frame = self._provider.new_frame(FRAME_ID_TO_DEVICE)
        self._step = max(1, cycle_ns // COUNTER_UNIT_NS)
        self._counts = 0
        """Time for the cycle counter."""
        self.tick = bytes(TICK.size)
        """Tick of the gateway's newest frame, which each frame to it contains; 0 before the first one."""
        self._last_counter: int | None = None
        self._last_time = 0
        self._watchdog_ns = max(_WATCHDOG_NS, _WATCHDOG_CYCLES * cycle_ns)
        self.setpoints_used: list[bool] = [False] * len(self.telegrams)
        """Whether the gateway uses the setpoints (its IOCS)."""
        self._counting: dict[int, tuple[str, Bit]] = {}
        """Axes whose sign of life counts, with its word and bits."""
        self.run = True
        """Provider state of the PLC: RUN or STOP."""
        self.bad: set[int] = set()
        """Axes whose setpoints the PLC marks BAD (its IOPS)."""

    def set(self, axis: int, values: Mapping[str, int]) -> None:
        """Change setpoints by name; ProfidriveError for a signal the telegram lacks or a value that does not fit."""
        half = self.telegrams[axis].setpoints
        merged = {**self.setpoints[axis], **values}
        half.encode(half.from_dict(merged))
        self.setpoints[axis] = merged

    def count(self, axis: int, word: str, bit: Bit | None) -> None:
        """Count the sign of life in these bits of a setpoint with each frame; None: keep it constant."""
        if bit is None:
            self._counting.pop(axis, None)
        else:
            self._counting[axis] = (word, bit)

    def count_sign_of_life(self) -> None:
        """Advance the counting signs of life by one cycle."""
        for axis, (word, bit) in self._counting.items():
            before = self.setpoints[axis][word]
            life = bit.of(before) % (bit.mask >> bit.position) + 1  # 1 to 15; 0 means no sign of life
            self.setpoints[axis] = {**self.setpoints[axis], word: before & ~bit.mask | life << bit.position}

    def build(self, now: int | None = None) -> bytearray:
        """The next frame to the gateway; the buffer is reused.

        ``now``: its send time, for the cycle counter. Without it each frame is one cycle after the last.
        """
        frame, layout = self._frame, self._provider
        self.count_sign_of_life()
        for index, half in enumerate(layout.halves):
            half.encode_into(frame, layout.offsets[index], tuple(self.setpoints[index].values()))
            frame[layout.iops[index]] = IOPS_BAD if index in self.bad else IOPS_GOOD
            frame[layout.iocs[index]] = IOPS_GOOD if self.actuals[index] is not None else IOPS_BAD
        self._counts = self._counts + self._step if now is None else max(self._counts + 1, now // COUNTER_UNIT_NS)
        frame[layout.tick : layout.trailer] = self.tick
        TRAILER.pack_into(frame, layout.trailer, self._counts & 0xFFFF, STATUS_NORMAL if self.run else STATUS_STOP, 0)
        self.counters["sent"] += 1
        return frame

    def why_no_values(self, axis: int) -> str:
        """Why an axis has no valid actual values, and the remedy."""
        others = sum(self.counters[name] for name in _UNUSABLE)
        if not self.counters["received"]:
            if others:
                size = self._consumer.frame_size
                return (
                    f"received {others} datagrams, but none is a frame of {size} bytes as these telegrams need; "
                    "does the gateway have other telegrams, or another number of axes?"
                )
            return (
                f"no datagram from a gateway: start one ({self._simulation()}) or give its address; if it runs, another PLC may "
                "be connected to it, see pdgw status"
            )
        if self._last_counter is None:
            return "the gateway's frames have stopped"
        if self.actuals[axis] is None:
            return "the gateway marks the values as bad (IOPS BAD): the device is not ready, see pdgw status"
        return ""

    def _simulation(self) -> str:
        """The command that simulates these drive objects. Encoders of several types need a configuration."""
        encoders = [item.number for item in self.telegrams if item.mode is ApplicationMode.ENCODER]
        axes = [item.number for item in self.telegrams if item.mode is not ApplicationMode.ENCODER]
        if not axes or len(set(encoders)) > 1:
            return "pdgw run CONFIG"
        different = axes if len(set(axes)) > 1 else axes[:1]
        command = "pdgw run --simulate" + "".join(f" --telegram {number}" for number in different)
        if len(axes) > len(different):
            command += f" --axes {len(axes)}"
        return f"{command} --encoders {len(encoders)} --encoder-telegram {encoders[0]}" if encoders else command

    def poll(self, now: int) -> bool:
        """Check the watchdog; True when it expires in this call. Old values of a lost gateway must not meet expectations."""
        if self._last_counter is None or now - self._last_time <= self._watchdog_ns:
            return False
        self._last_counter = None
        self.counters["watchdog"] += 1
        self.actuals = [None] * len(self.telegrams)
        self.setpoints_used = [False] * len(self.telegrams)
        return True

    def accept(self, actuals: Sequence[Sequence[int] | None], used: Sequence[bool], now: int) -> None:
        """Store data of a link: each axis' values (None: IOPS BAD), and whether its setpoints are used (IOCS)."""
        self._last_counter = 0
        self._last_time = now
        self.counters["received"] += 1
        for index, values in enumerate(actuals):
            self.actuals[index] = None if values is None else self.telegrams[index].actuals.as_dict(values)
            self.setpoints_used[index] = used[index]

    def receive(self, data: bytes, now: int = 0) -> bool:
        """Process a frame of the gateway. False (counted) when it is not a newer valid frame of this relationship."""
        layout = self._consumer
        try:
            frame = RtFrame.decode(data)
        except ProfidriveError:
            self.counters["malformed"] += 1
            return False
        if frame.frame_id != FRAME_ID_TO_CONTROLLER or len(data) != layout.frame_size:
            self.counters["foreign"] += 1
            return False
        self.tick = data[layout.tick : layout.trailer]
        if self._last_counter is not None and not is_newer(frame.cycle_counter, self._last_counter):
            self.counters["stale"] += 1
            return False
        if not frame.data_status & STATUS_DATA_VALID:
            self.counters["not valid"] += 1
            return False
        if not frame.data_status & STATUS_PRIMARY:
            self.counters["not primary"] += 1
            return False
        actuals = [
            half.decode(data, offset) if data[iops] & IOPS_GOOD else None
            for half, offset, iops in zip(layout.halves, layout.offsets, layout.iops, strict=True)
        ]
        self.accept(actuals, [bool(data[iocs] & IOPS_GOOD) for iocs in layout.iocs], now)
        self._last_counter = frame.cycle_counter
        return True
