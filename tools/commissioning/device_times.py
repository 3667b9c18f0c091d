"""What a drive needs of the time that the gateway gives it: the habits measured in its frames, beside the limits."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import can

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.communication import ERROR_CONTROL, SDO_REQUEST, SDO_RESPONSE, NmtState
from pdgw.ds301.node.node import NodeSettings
from pdgw.ds301.node.plan import Pace, PdoPlan, PlannedPdo
from pdgw.ds301.sdo_frames import COMMAND, DOWNLOAD, UPLOAD, address_in, address_of
from pdgw.dsp402.drive.client import DriveClient
from pdgw.dsp402.objects import CONTROL_ATTRIBUTE, MODE, MODE_DISPLAY, STATUS_ATTRIBUTE
from pdgw.dsp402.states import State, next_state, state_of
from pdgw.gateway.axis.settings import AxisSettings
from pdgw.gateway.commissioning.supervisions import SUPERVISIONS, Measured

_OPERATIONAL: Final = bytes((NmtState.OPERATIONAL,))
_SDO_BYTES: Final = 8
_WRITTEN, _READ = address_of(*MODE), address_of(*MODE_DISPLAY)
_NEAR: Final = 2
"""A limit is near if the time is longer than the limit divided by this."""
_COMMANDS: Final = {
    State.OPERATION_ENABLED: Measured.LEAVES,
    State.SWITCHED_ON: Measured.ENTERS,
    State.FAULT: Measured.ACKNOWLEDGE,
}
"""By the state that a Controlword ends; another one is the reaction to a command."""


class DeviceTimes:
    """The times of each habit of one drive, by its supervision. Give ``see`` each frame of its bus."""

    def __init__(self, client: DriveClient) -> None:
        self.found: dict[str, tuple[int, int]] = {}
        """The shortest and the longest one, in nanoseconds."""
        self._client = client
        self._heartbeat, self._sdo = (base + client.settings.node_id for base in (ERROR_CONTROL, SDO_REQUEST))
        self._plan: PdoPlan | None = None
        self._rpdos: dict[int, PlannedPdo] = {}
        self._tpdos: dict[int, PlannedPdo] = {}
        self._last: dict[int, int] = {}
        """Arrival of the last frame, by COB-ID."""
        self._word = 0
        self._state: State | None = None
        self._commanded: tuple[Measured, int] | None = None
        """What the last Controlword began, and when."""
        self._asked: int | None = None
        """When the SDO request was sent that has no answer yet."""
        self._mode: tuple[int, int] | None = None
        """The mode that 6061h does not show yet, and when it was sent."""

    def add(self, name: Measured, duration: int) -> None:
        """Another time of a habit, in nanoseconds."""
        shortest, longest = self.found.get(name, (duration, duration))
        self.found[name] = min(duration, shortest), max(duration, longest)

    def see(self, message: can.Message, now: int) -> None:
        """A frame that was sent or received at this time, in nanoseconds."""
        cob_id, data, plan = message.arbitration_id, bytes(message.data), self._client.plan
        if plan is not self._plan and plan is not None:
            self._plan = plan
            self._rpdos = {item.cob_id: item for item in plan.rpdos}
            self._tpdos = {item.cob_id: item for item in plan.tpdos}
        if message.is_rx and cob_id == self._heartbeat and data == _OPERATIONAL:
            self._came(Measured.HEARTBEAT, cob_id, now)
        elif message.is_rx and cob_id in self._tpdos:
            item = self._tpdos[cob_id]
            if item.pace is not Pace.CHANGE:
                self._came(Measured.TPDO, cob_id, now)
            self._shown(dict(_values(item, data)), now)
        elif not message.is_rx and cob_id in self._rpdos:
            self._sent(dict(_values(self._rpdos[cob_id], data)), now)
        elif len(data) == _SDO_BYTES and cob_id in (self._sdo, self._sdo + SDO_RESPONSE - SDO_REQUEST):
            self._transferred(message, now)

    def _came(self, name: Measured, cob_id: int, now: int) -> None:
        if cob_id in self._last:
            self.add(name, now - self._last[cob_id])
        self._last[cob_id] = now

    def _sent(self, values: dict[str, int], now: int) -> None:
        word, state = values.get(CONTROL_ATTRIBUTE, self._word), self._state
        if state is not None and word != self._word and next_state(state, word, self._word) is not state:
            self._commanded = _COMMANDS.get(state, Measured.REACTS), now
        self._word = word

    def _shown(self, values: dict[str, int], now: int) -> None:
        if STATUS_ATTRIBUTE in values:
            state = state_of(values[STATUS_ATTRIBUTE])
            if state is not self._state and self._commanded is not None:
                name, since = self._commanded
                self.add(name, now - since)
                self._commanded = None
            self._state = state

    def _transferred(self, message: can.Message, now: int) -> None:
        """The time of an answer; the mode, which the gateway writes and then reads at every bring-up."""
        if not message.is_rx:
            self._asked = now
        elif self._asked is not None:
            self.add(Measured.SDO, now - self._asked)
            self._asked = None
        data = bytes(message.data)
        address, kind, value = address_in(data), data[0] & COMMAND, data[4]
        if address == _WRITTEN and kind == DOWNLOAD:
            self._mode = value, now
        elif address == _READ and kind == UPLOAD and self._mode is not None and value == self._mode[0]:
            self.add(Measured.MODE, now - self._mode[1])
            self._mode = None

    def lines(self, node: NodeSettings, axis: AxisSettings) -> Iterator[str]:
        """For the user: each habit that was measured beside its limit, and the rest."""
        for item in SUPERVISIONS:
            if item.limit is None or item.name not in self.found:
                continue
            shortest, longest = self.found[item.name]
            limit = item.limit(node, axis)
            times = (
                time_text(longest)
                if time_text(longest) == time_text(shortest)
                else f"{time_text(shortest)} to {time_text(longest)}"
            )
            advice = f" NEAR: raise {item.key}" if item.key else " NEAR: shorten it in the drive"
            yield f"  {item.name:<32} {times}; limit {time_text(limit)}{advice if longest * _NEAR > limit else ''}"
        missing = [name for name in Measured if name not in self.found]
        if missing:
            yield f"  not measured: {', '.join(missing)}"


def _values(item: PlannedPdo, data: bytes) -> Iterator[tuple[str, int]]:
    """The values of a PDO by attribute; none of a frame that is too short."""
    pdo = item.pdo
    if len(data) >= pdo.size:
        yield from zip(pdo.attributes, pdo.struct.unpack_from(data), strict=True)


def time_text(time: int) -> str:
    """A time in nanoseconds, in seconds or milliseconds."""
    return f"{time / SECOND:.3g} s" if time >= SECOND else f"{max(1, round(time / MS))} ms"
