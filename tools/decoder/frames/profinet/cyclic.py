"""Decoder of cyclic RT frames. Their telegrams are given, observed in P922 or in a Connect, or inferred.

Source: IEC 61158-6-10 (FrameIDs). Not here: fragments.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from pdgw.dsp402.identification.overlay import NO_CHOICE, Families
from pdgw.profidrive.frame import (
    C_SDU_MIN,
    FRAME_ID_TO_CONTROLLER,
    FRAME_ID_TO_DEVICE,
    HEADER,
    IOPS_BAD,
    IOPS_GOOD,
    STATUS_DATA_VALID,
    STATUS_RUN,
    TICK,
    TRAILER,
)
from pdgw.profidrive.telegrams import TELEGRAMS, Direction, Telegram, likeliest, telegram
from pdgw.profinet.connection.connect import CyclicPlan
from pdgw.profinet.model import TELEGRAM_IDENT, Subslot
from pdgw.tools.decoder.frames.fields import BoundedDict
from pdgw.tools.decoder.frames.profinet.connect import Connection
from pdgw.tools.decoder.frames.profinet.frame_telegrams import (
    Axis,
    Candidate,
    Placement,
    combine,
    frame_layout,
    infer,
    is_one_of,
    placed_layout,
)
from pdgw.tools.decoder.frames.profinet.frames import named_frame
from pdgw.tools.decoder.frames.records import CyclicRecord, FrameLayout, OtherRecord, Record

_CYCLIC_FIRST = 0x8000
_CYCLIC_LAST = 0xFBFF
_FRAME_MIN = HEADER.size + C_SDU_MIN + TRAILER.size
_DIRECTIONS = {FRAME_ID_TO_DEVICE: Direction.SETPOINT, FRAME_ID_TO_CONTROLLER: Direction.ACTUAL}
_ATTEMPTS = 500
"""Number of frames of one kind that are all checked for their telegrams; then every ``_SELDOM``-th."""
_SELDOM = 64
_MAX_KINDS = 4096
"""Different kinds of frame remembered."""
_MAX_TICKS = 8192
"""Ticks remembered: more than the gateway sends within the longest age limit."""
_MAC = 6
_LIVE = STATUS_RUN | STATUS_DATA_VALID


_Kind = tuple[int, int, bytes]
"""FrameID, length, destination and source: frames that look alike."""


class CyclicDecoder:
    """All cyclic frames of a capture. ``notify`` is called with the source of inferred telegrams. ``telegrams``: those known."""

    def __init__(
        self,
        axes: Sequence[Axis],
        notify: Callable[[str], None],
        station: str = "",
        telegrams: Mapping[int, Telegram] = TELEGRAMS,
        families: Families = NO_CHOICE,
    ) -> None:
        for axis in axes:
            telegram(axis.telegram, telegrams)
        self._telegrams, self._families = telegrams, families
        self._given = tuple(axes)
        self._station = station
        self._notify = notify
        self._observed: dict[int, int] = {}
        self.inference = ""
        """The last report about inferred telegrams."""
        self._candidates: list[Candidate] | None = None
        self._seen: set[Direction] = set()
        self._misfits: Counter[Direction] = Counter()
        self._layouts: dict[_Kind, FrameLayout] = {}
        self._plain: dict[_Kind, tuple[int, FrameLayout]] = {}
        """Frames with unknown telegrams: their number, and the layout without signals."""
        self._relations: dict[tuple[int, bytes], tuple[Direction, CyclicPlan, Connection]] = {}
        """By FrameID, destination and source of the frames; empty where these are unknown."""
        self._requested: BoundedDict[tuple[int, bytes], tuple[CyclicPlan, Connection]] = BoundedDict()
        """Inputs of a Connect without an answer, by FrameID and controller: the device may send before it answers."""
        self._connection: Connection | None = None
        """The last Connect that has telegrams."""
        self._sent_ticks: dict[int, int] = {}
        """Ticks of the gateway's newest frames, and their times."""

    @property
    def axes(self) -> tuple[Axis, ...]:
        """The axes known at present: given or inferred, with the telegrams observed in P922."""
        if self._given:
            axes = self._given
        elif self._connection is not None:
            axes = tuple(axis for axis, _ in self._fitting(self._connection, {}))
        elif self._candidates:
            axes = tuple(Axis(i, likeliest(numbers)) for i, numbers in enumerate(self._candidates[0], 1))
        elif set(self._observed) == set(range(1, len(self._observed) + 1)):
            axes = tuple(Axis(do_id, 0) for do_id in sorted(self._observed))
        else:
            return ()
        return tuple(replace(axis, telegram=self._observed.get(axis.do_id, axis.telegram)) for axis in axes)

    @property
    def inferred(self) -> tuple[Axis, ...]:
        """The axes as the frames alone show them, whatever was given or observed besides."""
        return (
            tuple(Axis(i, min(numbers)) for i, numbers in enumerate(self._candidates[0], 1)) if self._candidates else ()
        )

    @property
    def sure(self) -> bool:
        """Whether live frames of both directions were checked, so that ``inferred`` is final."""
        return len(self._seen) == len(Direction)

    def request(self, connection: Connection) -> bool:
        """Use the FrameID of the inputs until the answer. False if the Connect has no telegrams."""
        self._layouts.clear()
        plan = connection.plan(Direction.ACTUAL)
        if plan is not None and connection.ar is not None:
            self._requested.put((plan.frame_id, connection.ar.initiator_mac), (plan, connection))
        return bool(self._connected(connection))

    def end_request(self, connection: Connection) -> None:
        """The Connect is answered."""
        self._layouts.clear()
        plan = connection.plan(Direction.ACTUAL)
        if plan is not None and connection.ar is not None:
            self._requested.pop((plan.frame_id, connection.ar.initiator_mac))

    def connect(self, connection: Connection) -> bool:
        """Use the FrameIDs of a new Connect. False if it is not from the chosen station."""
        self.end_request(connection)
        for direction, plan in connection.relations:
            if len(self._relations) >= _MAX_KINDS:
                self._relations.clear()
            key = (plan.frame_id, connection.addresses(direction) or b"")
            self._relations.pop(key, None)
            self._relations[key] = (direction, plan, connection)
        found = [f"axis {axis.do_id} telegram {axis.telegram}" for axis, _ in self._connected(connection)]
        if not found:
            return False
        whose = f" of {connection.station}" if connection.station else ""
        chosen = self._chosen(connection)
        if chosen:
            self._connection = connection
            self._notify(f"observed in Connect{whose}: {', '.join(found)}")
        else:
            self._notify(f"ignored: another station{whose} with {', '.join(found)}; choose it with --station")
        return chosen

    def _chosen(self, connection: Connection) -> bool:
        """Whether a station is the one to be read: the named one, else the first that has telegrams."""
        if self._station:
            return connection.station == self._station
        first = self._connection
        return (
            first is None
            or None in {first.device_mac, connection.device_mac}
            or (first.device_mac == connection.device_mac)
        )

    def _connected(self, connection: Connection) -> list[tuple[Axis, Subslot]]:
        """The submodules of drive objects whose lengths are those of a telegram. The n-th drive object is in slot n.

        Outside the API of PROFIdrive (gateways with plain modules), only those in the slots of given axes.
        """
        known = {axis.slot or place: axis for place, axis in enumerate(self.axes, 1)}
        return self._fitting(connection, known)

    def _fitting(self, connection: Connection, known: Mapping[int, Axis]) -> list[tuple[Axis, Subslot]]:
        found = []
        for place in connection.places:
            if place not in connection.profidrive and not (self._given and place[0] in known):
                continue
            sizes = connection.sizes(place)
            telegrams = self._telegrams.items()
            fitting = [n for n, t in telegrams if [t.half(direction).size for direction in Direction] == sizes]
            axis = known.get(place[0]) or Axis(place[0], 0, slot=place[0])
            # The gateway's own submodules name their telegram; others have only a length.
            named = connection.submodules[place].ident - TELEGRAM_IDENT
            number = named if named in fitting else self._observed.get(axis.do_id, axis.telegram)
            if fitting:
                number = number if number in fitting else likeliest(fitting, self._telegrams)
                found.append((replace(axis, telegram=number), place))
        return found

    def _relation(self, frame_id: int, addresses: bytes) -> tuple[Direction, CyclicPlan, Connection] | None:
        """The relationship of a frame; the newest one if its addresses are ambiguous."""
        requested = self._requested.get((frame_id, addresses[:_MAC]))
        if requested is not None:
            plan, connection = requested
            return Direction.ACTUAL, plan, replace(connection, device_mac=addresses[_MAC:])
        if addresses:
            return self._relations.get((frame_id, addresses)) or self._relations.get((frame_id, b""))
        found = (item for (known, _), item in reversed(self._relations.items()) if known == frame_id)
        return next(found, None)

    def _connected_layout(
        self, direction: Direction, plan: CyclicPlan, connection: Connection, length: int
    ) -> FrameLayout:
        if not self._chosen(connection):
            return _plain_layout(length, None, f"belongs to another station, {connection.station}".rstrip())
        placements = []
        for axis, place in self._connected(connection):
            if place in plan.data and place in plan.iocs:
                data = plan.data[place]
                begin, iops = HEADER.size + data.offset, HEADER.size + data.iops
                half = self._telegrams[axis.telegram].half(direction)
                placements.append(Placement(axis, half, begin, iops, HEADER.size + plan.iocs[place]))
        layout = placed_layout(placements, direction, length, self._families)
        return layout or _plain_layout(length, direction, "length differs from the length in its Connect")

    def observe(self, do_id: int, number: int) -> None:
        """P922 of a DO was seen. An unknown telegram is reported and ignored."""
        if self._observed.get(do_id) == number:
            return
        if number not in self._telegrams:
            self._notify(f"axis {do_id}: P922 = {number} is an unknown telegram")
            return
        before = {axis.do_id: axis.telegram for axis in self.axes}.get(do_id)
        self._observed[do_id] = number
        self._layouts.clear()
        if before != number:
            self._notify(f"axis {do_id}: telegram {number}, observed in P922")

    def decode(self, number: int, time_ns: int, channel: str, data: bytes, addresses: bytes = b"") -> Record:
        """The record of one RT frame. ``addresses``: destination and source MAC, where it came on Ethernet."""
        frame_id = data[0] << 8 | data[1] if len(data) > 1 else 0
        layout = self._layouts.get((frame_id, len(data), addresses))
        if layout is None:
            if not _CYCLIC_FIRST <= frame_id <= _CYCLIC_LAST or len(data) < _FRAME_MIN:
                return OtherRecord(number, time_ns, channel, data, text=_refusal(frame_id, data))
            layout = self._find(frame_id, data, addresses)
        record = CyclicRecord(number, time_ns, channel, data, layout, layout.struct.unpack(data))
        if layout.tick:
            self._note_age(record)
        return record

    def _note_age(self, record: CyclicRecord) -> None:
        """The age of a PLC's frame: from the gateway's frame with the same tick to this one."""
        tick = record.tick
        if not tick:
            return
        if record.direction is Direction.SETPOINT:
            sent_ns = self._sent_ticks.get(tick)
            record.age_ns = None if sent_ns is None else record.time_ns - sent_ns
        elif tick not in self._sent_ticks:
            if len(self._sent_ticks) >= _MAX_TICKS:
                del self._sent_ticks[next(iter(self._sent_ticks))]
            self._sent_ticks[tick] = record.time_ns

    def _find(self, frame_id: int, data: bytes, addresses: bytes) -> FrameLayout:
        key = (frame_id, len(data), addresses)
        count, plain = self._plain.get(key, (0, None))
        if plain is not None:
            self._plain[key] = (count + 1, plain)
            if count > _ATTEMPTS and count % _SELDOM:
                return plain
        if len(self._layouts) + len(self._plain) > _MAX_KINDS:
            self._layouts.clear()
            self._plain.clear()
        known = self._relation(frame_id, addresses)
        if known is not None:
            connected = self._layouts[key] = self._connected_layout(*known, len(data))
            return connected
        direction = _DIRECTIONS.get(frame_id)
        if direction is None:
            layout = self._layouts[key] = _plain_layout(
                len(data), None, "FrameID of another relationship, or its Connect is not in the capture"
            )
            return layout
        if self._given:
            self._report_misfit(direction, data)
        else:
            self._infer(direction, data)
        axes = self.axes
        fitting = frame_layout(axes, direction, len(data), self._telegrams, self._families) if axes else None
        if fitting is not None:
            if direction in self._seen or self._candidates:
                self._layouts[key] = fitting
            return fitting
        if axes:
            note = f"too short for telegram {', '.join(str(axis.telegram) for axis in axes)}"
        else:
            note = "telegram unknown: give --telegram or --config"
        if plain is None or plain.note != note:
            plain = _plain_layout(len(data), direction, note)
            self._plain[key] = (count + 1, plain)
        return plain

    def _report_misfit(self, direction: Direction, data: bytes) -> None:
        """Report once for each direction when the status bytes of live frames are at the places of other telegrams.

        The first frames of a connection have BAD status bytes and prove nothing, so later ones are checked too.
        """
        if direction in self._seen or self._has_bad_object(direction, data[HEADER.size : -TRAILER.size]):
            return
        self._misfits[direction] += 1
        found = infer(data[HEADER.size : -TRAILER.size], direction) if data[-2] & _LIVE == _LIVE else []
        if found or self._misfits[direction] > _ATTEMPTS:
            self._seen.add(direction)
        given = [axis.telegram for axis in self.axes]
        if found and not any(is_one_of(given, candidate) for candidate in found):
            asked = ", ".join(str(number) for number in given)
            shown = ", ".join("/".join(str(number) for number in sorted(numbers)) for numbers in found[0])
            what = "setpoints" if direction is Direction.SETPOINT else "actual values"
            self._notify(
                f"the {what} do not fit the given telegram {asked}: their length is the length of telegram {shown}"
            )

    def _has_bad_object(self, direction: Direction, c_sdu: bytes) -> bool:
        """Return whether the given telegrams explain all status bytes and an IOPS is BAD: nothing can be inferred then."""
        place, iops = 0, bytearray()
        for axis in self.axes:
            place += self._telegrams[axis.telegram].half(direction).size
            iops += c_sdu[place : place + 1]
            place += 1
        iocs = c_sdu[place : place + len(self.axes)]
        return (
            IOPS_BAD in iops
            and set(iops) <= {IOPS_GOOD, IOPS_BAD}
            and iocs == bytes([IOPS_GOOD] * len(self.axes))
            and not any(c_sdu[place + len(self.axes) : -TICK.size])
        )

    def _infer(self, direction: Direction, data: bytes) -> None:
        """Narrow the telegrams down by a live frame of a direction that was not checked yet."""
        if direction in self._seen or data[-2] & _LIVE != _LIVE:
            return
        found = infer(data[HEADER.size : -TRAILER.size], direction)
        if found and self._candidates is not None:
            found = combine(self._candidates, found)
        if not found:
            return
        before = self.axes
        self._seen.add(direction)
        self._candidates = found
        self._layouts.clear()
        after = self.axes
        if [axis.telegram for axis in before] != [axis.telegram for axis in after]:
            self.inference = _inferred(found[0], after)
            self._notify(self.inference)


def _plain_layout(length: int, direction: Direction | None, note: str) -> FrameLayout:
    """Header and trailer of a frame whose telegrams are not known."""
    return FrameLayout(struct.Struct(f">H{length - HEADER.size - TRAILER.size}xHBB"), direction, note=note)


def _inferred(candidate: Candidate, axes: Sequence[Axis]) -> str:
    texts = []
    for axis, numbers in zip(axes, candidate, strict=True):
        others = ", ".join(str(number) for number in sorted(numbers - {axis.telegram}))
        texts.append(f"axis {axis.do_id} telegram {axis.telegram}" + (f" (as long: {others})" if others else ""))
    return f"inferred from length and status bytes: {'; '.join(texts)}; override it with --telegram"


def _refusal(frame_id: int, data: bytes) -> str:
    if not _CYCLIC_FIRST <= frame_id <= _CYCLIC_LAST:
        return f"FrameID {frame_id:04X}h is {named_frame(frame_id)}, {len(data)} bytes"
    return f"{len(data)} bytes are too short for a cyclic frame, expected at least {_FRAME_MIN}"
