"""The RPDOs of a replay: each payload of today's machine against those of the recording, in their order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from pdgw.decoder.replay.recorded import AxisRecording, Sent
from pdgw.decoder.replay.result import Difference
from pdgw.ds301.pdo import Pdo
from pdgw.dsp402.drive.images import DriveCommand
from pdgw.dsp402.drive.settings import DriveSettings
from pdgw.dsp402.objects import DRIVE_OBJECTS, MAX_TORQUE
from pdgw.durations import MS

REFRESH_NS: Final = DriveSettings(node_id=1).rpdo_refresh_ms * MS
"""The gateway repeats an RPDO after this time."""
SENDING_GAP_NS: Final = 3 * REFRESH_NS
"""A longer silence means that the gateway does not send to this drive."""


@dataclass(frozen=True, slots=True)
class _Span:
    """Payloads the gateway sent to one drive without a break, repetitions left out, by RPDO number.

    From the ``last`` frame to the ``end``, when the next refresh was due, a silence means that nothing has changed.
    """

    begin: int
    last: int
    end: int
    sent: dict[int, list[Sent]]


def _without_repetitions(frames: Sequence[Sent]) -> list[Sent]:
    return [item for i, item in enumerate(frames) if not i or frames[i - 1].data != item.data]


def _spans(sent: Mapping[int, Sequence[Sent]], can_end_ns: int) -> list[_Span]:
    times = [item.time_ns for item in sent.get(1, ())]
    limits: list[tuple[int, int]] = []
    for now in times:
        if limits and now - limits[-1][1] <= SENDING_GAP_NS:
            limits[-1] = (limits[-1][0], now)
        else:
            limits.append((now, now))
    spans = []
    for begin, end in limits:
        margin = SENDING_GAP_NS // 2
        inside = {
            number: _without_repetitions([f for f in frames if begin - margin <= f.time_ns <= end + margin])
            for number, frames in sent.items()
        }
        due = max(end, min(end + REFRESH_NS, can_end_ns))
        spans.append(_Span(begin, end, due, {number: frames for number, frames in inside.items() if frames}))
    return spans


@dataclass(slots=True)
class Place:
    """The state of a hypothesis: its span (-1: none), and the last payload by RPDO number."""

    span: int = -1
    cursors: dict[int, int] = field(default_factory=dict)

    def copy(self) -> Place:
        return Place(self.span, dict(self.cursors))


class RpdoComparison:
    """Compares the RPDOs of one axis, without Max Torque if the drive's own limit is unknown. ``last_ns``: the time of the last
    step."""

    def __init__(self, recording: AxisRecording, *, cycle_ns: int, tolerance_ns: int, last_ns: int) -> None:
        self._do_id = recording.do_id
        self._rpdos = recording.rpdos
        self._blanks = {} if recording.torque_is_known else recording.torque_places
        """The bytes that are not compared, by RPDO number."""
        sent = {
            number: [item._replace(data=self._blank(number, item.data)) for item in frames]
            for number, frames in recording.sent.items()
        }
        self._spans = _spans(sent, recording.can_end_ns)
        self._cycle_ns = cycle_ns
        self._tolerance = tolerance_ns
        self._last_ns = last_ns

    def _blank(self, number: int, data: bytes) -> bytes:
        """A payload with 0 in the bytes that are not compared."""
        place = self._blanks.get(number)
        if place is None or len(data) < place.stop:
            return data
        return data[: place.start] + bytes(place.stop - place.start) + data[place.stop :]

    def follow(self, place: Place, now: int) -> None:
        """While nothing is compared: the payloads in force by their time alone."""
        place.span = next((i for i, span in enumerate(self._spans) if span.begin <= now <= span.end), -1)
        place.cursors.clear()

    def compare(self, place: Place, now: int, command: DriveCommand, *, online: bool) -> Difference | None:
        """Compare a step's RPDOs with the recording; the position advances if they match."""
        if place.span < 0 or now > self._spans[place.span].end:
            self.follow(place, now)
            if place.span < 0:
                return None
        span = self._spans[place.span]
        if now > span.last and not online:
            return None
        for pdo in self._rpdos:
            frames = span.sent.get(pdo.number)
            if frames is None:
                continue
            data = self._blank(pdo.number, pdo.pack(command))
            difference = self._compare_rpdo(pdo, frames, data, place.cursors, now)
            if difference is not None:
                return difference
        return None

    def _compare_rpdo(
        self, pdo: Pdo, frames: Sequence[Sent], data: bytes, cursors: dict[int, int], now: int
    ) -> Difference | None:
        """The payload of this step is the one in force, or the next of the recording at about its time."""
        tolerance = self._tolerance
        cursor = cursors.get(pdo.number)
        if cursor is None:
            return self._enter(pdo, frames, data, cursors, now)
        following = frames[cursor + 1] if cursor + 1 < len(frames) else None
        if data == frames[cursor].data:
            # After the last step there is no cause left for what the recording contains.
            late = 2 * self._cycle_ns if now >= self._last_ns else tolerance
            if following is None or following.time_ns >= now - late:
                return None
            return self._sent_difference(pdo, following.time_ns, following.data, data)
        if following is None or following.data != data:
            due = following is not None and following.time_ns <= now + tolerance
            recorded = following if due and following is not None else frames[cursor]
            return self._sent_difference(pdo, recorded.time_ns if due else now, recorded.data, data)
        if abs(following.time_ns - now) > tolerance:
            note = (
                f"the same content, recorded {(following.time_ns - now) / MS:+.1f} ms away from the time at "
                "which this version sends it"
            )
            return self._sent_difference(pdo, now, frames[cursor].data, data, note)
        cursors[pdo.number] = cursor + 1
        return None

    def _enter(
        self, pdo: Pdo, frames: Sequence[Sent], data: bytes, cursors: dict[int, int], now: int
    ) -> Difference | None:
        """The first payload that is compared: any that was in force about now."""
        tolerance = self._tolerance
        last = None
        for position, item in enumerate(frames):
            if item.time_ns > now + tolerance:
                break
            over = position + 1 < len(frames) and frames[position + 1].time_ns < now - tolerance
            if over:
                continue
            last = item
            if item.data == data:
                cursors[pdo.number] = position
                return None
        if last is None or (last is frames[0] and last.time_ns > now - tolerance):
            return None  # sent for the first time at about this time
        return self._sent_difference(pdo, now, last.data, data)

    def _sent_difference(self, pdo: Pdo, time_ns: int, recorded: bytes, today: bytes, note: str = "") -> Difference:
        if len(recorded) != pdo.size:
            note = note or f"{len(recorded)} bytes recorded, {pdo.size} in this version: {recorded.hex(' ')}"
            return Difference(time_ns, self._do_id, str(pdo), None, self._named(pdo, today), note)
        return Difference(time_ns, self._do_id, str(pdo), self._named(pdo, recorded), self._named(pdo, today), note)

    def _named(self, pdo: Pdo, data: bytes) -> dict[str, int]:
        values = pdo.struct.unpack(data)
        named = {entry.name: value for entry, value in zip(pdo.entries, values, strict=True)}
        if pdo.number in self._blanks:
            del named[DRIVE_OBJECTS.entry(*MAX_TORQUE).name]
        return named
