"""Touch probe of a drive, by SDO: arm it, poll it, read the latched value (``Outputs.probe``).

The drive latches the position itself, so the time of reading does not matter. Source: CiA 402-2, 60B8h to 60BDh.
"""

from __future__ import annotations

import logging
from collections import deque
from concurrent.futures import Future
from typing import Final

from pdgw.ds301.aborts import NOT_THERE, abort_text
from pdgw.ds301.sdo_transfer import SdoAbortedError
from pdgw.dsp402.drive import touch_probe
from pdgw.dsp402.drive.client import DriveClient
from pdgw.durations import MS
from pdgw.gateway.axis.values import News, ProbeAnswer, ProbeWish

log = logging.getLogger("gateway")

_LOOK_NS: Final = 20 * MS
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
                self._due = now + _LOOK_NS
        elif wish is not None and not self._ended and now >= self._due:
            self._due = now + _LOOK_NS
            self._job = self._drive.submit(lambda drive: self._look(drive, wish))
        return self._job is not None

    def _look(self, drive: DriveClient, wish: ProbeWish) -> None:
        status = drive.sdo.read_number(touch_probe.STATUS)
        stored = [edge for edge in wish.edges if status & touch_probe.stored_bit(edge)]
        if stored:
            self._ended = True
            read = {edge: drive.sdo.read_number(touch_probe.POSITIONS[edge], signed=True) for edge in stored}
            self._news.append(ProbeAnswer(wish, read))
        elif not touch_probe.enabled_bits(status):
            self._ended = True
            self._news.append(dropped(wish, status))

    def _failed(self, error: BaseException) -> None:
        wish, self._ended = self._wish, True
        if wish is None:
            return  # the probe could not be disabled: no client waits for the answer
        if isinstance(error, SdoAbortedError):
            self._news.append(refused(wish, error.code))
        else:
            # No answer, or one that canopen unpacks without checks: it must not end the exchange.
            log.warning("touch probe of node %d: %r", self._drive.settings.node_id, error)
            self._news.append(ProbeAnswer(wish, {}, str(error)))


def dropped(wish: ProbeWish, status: int) -> ProbeAnswer:
    """60B9h shows neither a position nor that the probe is enabled."""
    return ProbeAnswer(wish, {}, f"60B9h = {status:04X}h: the drive has disabled the touch probe")


def refused(wish: ProbeWish, abort: int) -> ProbeAnswer:
    """The drive has aborted an SDO of its touch probe."""
    return ProbeAnswer(wish, {}, abort_text(abort), abort not in NOT_THERE)


def _arm(drive: DriveClient, function: int) -> None:
    """Disable first, which clears the stored positions."""
    drive.sdo.write(touch_probe.FUNCTION, 0, bytes(_FUNCTION_BYTES))
    if function:
        drive.sdo.write(touch_probe.FUNCTION, 0, function.to_bytes(_FUNCTION_BYTES, "little"))
