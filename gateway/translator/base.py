"""What every translator offers the axis, and the settings they share.

Source: docs/translation.md.
"""

from __future__ import annotations

import copy
import enum
from abc import ABC, abstractmethod
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Generic, TypeGuard, TypeVar

from pdgw.dsp402.errors import Dsp402Error
from pdgw.dsp402.images import DriveCommand, DriveFeedback, References
from pdgw.gateway.reasons import Reason
from pdgw.profidrive.datatypes import Normalisation
from pdgw.profidrive.telegrams import Telegram

_IMMUTABLE = (int, str, tuple, enum.Enum, Normalisation, Telegram, type(None))
"""Types of attributes that a step replaces and never changes."""


LIMIT_STANDING_NS = 500_000_000
"""A drive that reports an internal limit and stands so long with a setpoint or task is held by it (a limit switch); one whose
speed is limited has left standstill by then."""


class PlcLossReaction(enum.Enum):
    """``on_plc_loss``: how the drive is stopped when the PLC is lost."""

    RAMP = "ramp"
    QUICK_STOP = "quick-stop"
    COAST = "coast"


class SetpointEnable(enum.Enum):
    """``setpoint_enable``: what STW1 bits 4-6 = 0 do in the velocity telegrams."""

    HOLD = "hold"
    """The last Target Velocity stays (the manufacturer's rule)."""
    PROFIDRIVE = "profidrive"
    """Bit 4 or 6 = 0: Target Velocity 0; bit 5 = 0: hold."""


@dataclass(frozen=True, slots=True)
class TranslatorSettings:
    """The user's choices for one axis."""

    on_plc_loss: PlcLossReaction = PlcLossReaction.QUICK_STOP
    setpoint_enable: SetpointEnable = SetpointEnable.HOLD
    modulo_axis: bool = False
    ramp_stop_resume: bool = False
    """ON during an OFF1 ramp stop resumes operation (the PROFIdrive standard allows it; off by default)."""
    standstill_window: Fraction = Fraction(1, 100)
    """Standstill when |velocity| is at most this share of the reference speed."""


@dataclass(frozen=True, slots=True)
class FaultEvent:
    """A fault or warning the translator raises: a number of ``gateway.reasons.GATEWAY_FAULTS`` and a detail."""

    number: int
    detail: str


@dataclass(frozen=True, slots=True)
class SdoWrite:
    """A value the device must take by SDO before the translator goes on."""

    index: int
    subindex: int
    value: int


FeedbackT = TypeVar("FeedbackT")
ReferencesT = TypeVar("ReferencesT")


class BaseTranslator(ABC, Generic[FeedbackT, ReferencesT]):
    """One cycle of one drive object, drive or encoder, is one ``step``.

    ``reason`` is the standing answer to "why does it not move" (None when everything asked for is being done). ``events``
    collects what happened in steps; the axis drains it. ``sdo_request`` holds writes the axis must perform beside the
    exchange, answered by ``sdo_done``; one that the translator withdraws or replaces needs no answer.
    """

    def __init__(self, telegram: Telegram) -> None:
        self.telegram = telegram
        self.reason: Reason | None = Reason.NO_PLC
        self.events: list[FaultEvent] = []
        self.sdo_request: tuple[SdoWrite, ...] | None = None
        self.saturations = 0
        """How often a value had to be limited; visible to the user."""

    @abstractmethod
    def set_references(self, references: ReferencesT | None, homing_method: int = 0) -> None:
        """Take new reference values (at start, after a write to one, after a restart of the device).

        None, or references that fail their check, make the axis refuse operation (fault event 104).
        """

    @abstractmethod
    def step(self, setpoints: Sequence[int] | None, feedback: FeedbackT, drive_ok: bool, now: int) -> Sequence[int]:
        """Translate one cycle.

        ``setpoints``: raw signal values in telegram order, None while there is no valid PLC (never seen, watchdog
        expired, provider STOP, IOPS BAD). ``drive_ok``: the device is configured and its data is fresh. ``now``:
        monotonic nanoseconds. Returns the raw actual values in telegram order.
        """

    @abstractmethod
    def drive_restarted(self) -> None:
        """The device booted or was re-configured: no standing request may act on it, references are set again."""

    @abstractmethod
    def sdo_done(self, error: str | None) -> None:
        """The writes of ``sdo_request`` are done (None) or failed (the reason); the axis has cleared the request."""


class Translator(BaseTranslator[DriveFeedback, References]):
    """The translator of a drive.

    ``command`` is the drive image the step updates in place; the axis packs the RPDOs from it. ``warning`` is the
    gateway's own share of ZSW1.7.
    """

    def __init__(self, telegram: Telegram, settings: TranslatorSettings) -> None:
        super().__init__(telegram)
        self.settings = settings
        self.command = DriveCommand()
        self.warning = False

    @property
    @abstractmethod
    def released(self) -> bool:
        """The interlock is released: an OFF does nothing but stop."""

    def checkpoint(self) -> dict[str, object]:
        """Everything a step may change, for ``restore``: a replay tries steps and takes them back."""
        return _copies(vars(self))

    def restore(self, checkpoint: Mapping[str, object]) -> None:
        """Go back to a checkpoint of this translator; it can be used again."""
        vars(self).update(_copies(checkpoint))

    def fingerprint(self) -> tuple[Hashable, ...]:
        """Equal for two moments of this translator from which it goes on alike."""
        return tuple(_frozen(value) for value in vars(self).values())

    def _usable(self, references: References) -> bool:
        """Whether the references pass their check; fault event 104 tells which one does not."""
        try:
            references.check()
        except Dsp402Error as error:
            self.events.append(FaultEvent(104, str(error)))
            return False
        return True


def _copies(attributes: Mapping[str, object]) -> dict[str, object]:
    return {name: value if _keeps(value) else copy.copy(value) for name, value in attributes.items()}


def _keeps(value: object) -> TypeGuard[Hashable]:
    """Whether a value stays as it is for ever."""
    return isinstance(value, _IMMUTABLE) or callable(value)


def _frozen(value: object) -> Hashable:
    """A value as a hashable one; tables of methods, which are the same for ever, as nothing."""
    if _keeps(value):
        return value
    if isinstance(value, list):
        return tuple(value)
    return tuple(_frozen(getattr(value, name)) for name in getattr(value, "__slots__", ()))
