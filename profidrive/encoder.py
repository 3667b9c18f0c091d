"""Encoder objects: the handshake of G1_STW and G1_ZSW, the position values, STW2_ENC and ZSW2_ENC. Sans-I/O.

Source: PROFIdrive encoder profile 4.1 (3.162), PROFIdrive profile 4.1 chapter 6.3.6 (sensor interface);
docs/devices.md, docs/telegrams.md. The states are in ``sensor_states``. Reference mark search and measurement on the fly
(G1_STW bits 0-7) are in ``measuring``; CiA 406 encoders have neither and answer them with error 0F01h.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction

from pdgw.base.durations import MS, SECOND, SECONDS_PER_MINUTE
from pdgw.profidrive.datatypes import DataType, n2, n4
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.measuring import Measuring, Refusal, Search
from pdgw.profidrive.normalisation import Normalisation
from pdgw.profidrive.sensor_states import (
    IN_ERROR,
    MEASURING,
    REFUSAL_ERRORS,
    SENSOR_STATUS,
    TRANSITIONS,
    SensorError,
    SensorEvent,
    SensorState,
)
from pdgw.profidrive.sign_of_life import SignOfLife
from pdgw.profidrive.signals import signal

_G1_STW = signal("G1_STW")
_G1_ZSW = signal("G1_ZSW")
_RELATIVE = _G1_STW.bit("PRESET_RELATIVE").mask
_PRESET = _G1_STW.bit("PRESET").mask
_ABSOLUTE = _G1_STW.bit("REQUEST_ABSOLUTE").mask
_PARK = _G1_STW.bit("PARK").mask
SENSOR_ACKNOWLEDGE = _G1_STW.bit("ERROR_ACKNOWLEDGE").mask
_COMMAND = _G1_STW.bit("COMMAND").mask
_ABSOLUTE_VALID = _G1_ZSW.bit("ABSOLUTE_VALID").mask
_EVERYTHING = 0xFFFF

_STW2_ENC = signal("STW2_ENC")
_ZSW2_ENC = signal("ZSW2_ENC")
_CONTROL_BY_PLC = _STW2_ENC.bit("CONTROL_BY_PLC").mask
ENCODER_ACKNOWLEDGE = _STW2_ENC.bit("FAULT_ACKNOWLEDGE").mask
_CONTROLLER_SIGN_OF_LIFE = _STW2_ENC.bit("SIGN_OF_LIFE")
_FAULT = _ZSW2_ENC.bit("FAULT").mask
_WARNING = _ZSW2_ENC.bit("WARNING").mask
_CONTROL_REQUESTED = _ZSW2_ENC.bit("CONTROL_REQUESTED").mask
_DEVICE_SIGN_OF_LIFE = _ZSW2_ENC.bit("SIGN_OF_LIFE")

PARKED_NS = 100 * MS
"""Minimum time of G1_ZSW.14 = 1, because masters poll it."""
PRESET_EFFECT_NS = SECOND
"""Longest time until a preset appears in a position that arrives in each cycle, after the answer or the end of its request. An
answered preset that does not appear has failed."""
_NEAR_STEPS = 4
"""A preset appears in the position if it differs by this number of steps of the motion at most."""


@dataclass(frozen=True, slots=True)
class PresetRequest:
    """Request to set the position to ``value`` (``relative``: shift it by ``value``), in measuring units.

    ``position`` is the resulting position below the total range, for encoders with absolute presets only.
    """

    value: int
    relative: bool
    position: int


class SensorInterface:
    """One sensor. Call ``step`` once per cycle.

    ``preset_value`` is P65000: absolute 0..total range - 1, relative any Integer32. While ``preset_request`` is not None, the
    owner must execute it and call ``preset_done`` or ``preset_failed``; a request that disappears (parking, an error) needs no
    answer. ``error`` is the last shown code. G1_XIST1 counts from the first position, across wraps of the total range; presets
    do not change it. G1_XIST3 is the same count in 64 bit, but a preset and the end of parking set it to the position.
    """

    def __init__(self, total_range: int, *, preset_supported: bool = True) -> None:
        """``total_range``: number of different position values (1..2^64), where the position wraps."""
        self.set_total_range(total_range)
        self.preset_supported = preset_supported
        self.preset_value = 0
        self.settle_ns = PRESET_EFFECT_NS
        """The same with the longest age of a position of this sensor."""
        self.preset_request: PresetRequest | None = None
        self.state = SensorState.NORMAL
        self.error: SensorError | None = None
        self.in_vain = False
        """The error was acknowledged while its cause was there, and the cause has not gone since then."""
        self.measuring: Measuring | None = None
        """State of a sensor that can latch positions; None: commands of G1_STW are not supported."""
        self._refused: Refusal | None = None
        self._answer: tuple[SensorEvent, SensorError | None] | None = None
        self._previous = _EVERYTHING
        self._position: int | None = None
        self._last: int | None = None
        self._count = 0
        self._moved = 0
        """The last motion between two steps that was not 0."""
        self._largest = 0
        """The largest one since the request of the preset."""
        self._asked_at = self._answered_at = 0
        """G1_XIST1 at the request of the preset and at its answer."""
        self._shift = 0
        self._parked_until = 0
        self._jump: PresetRequest | None = None
        self._jump_until: int | None = 0
        """Until when the preset may appear; None while its request waits for the answer."""
        self.ineffective: PresetRequest | None = None
        """The last preset that was confirmed and did not appear in the position."""

    def set_total_range(self, total_range: int) -> None:
        """The scaling of the sensor changed; the next position counts on from the present G1_XIST1."""
        if not 1 <= total_range <= 1 << 64:
            raise ProfidriveError("total measuring range", total_range, "1..2^64")
        self._range = total_range
        self._last = None

    @property
    def count(self) -> int:
        """G1_XIST1 before it is cut to 32 bit."""
        return self._count

    @property
    def xist3(self) -> int:
        """G1_XIST3."""
        return (self._count + self._shift) & 0xFFFF_FFFF_FFFF_FFFF

    def preset_done(self) -> None:
        """The sensor took the preset."""
        self._answered(SensorEvent.DONE, None)

    def preset_failed(self, error: SensorError = SensorError.MEMORY) -> None:
        """The sensor rejected the preset; ``error`` is the code for the PLC."""
        self._answered(SensorEvent.FAILED, error)

    def measured(self, search: Search, positions: Mapping[int, int]) -> None:
        """The device latched positions of a search, by function (0 to 3)."""
        if self.measuring is not None and self._last is not None:
            last, count = self._last, self._count
            self.measuring.found(search, {k: count + self._wrapped(v - last) for k, v in positions.items()})

    def measurement_failed(self, search: Search, *, supported: bool) -> None:
        """The device does not carry out a search, because it cannot (not ``supported``) or for another reason."""
        if self.measuring is not None and self.measuring.search is search:
            self._refused = Refusal.REFUSED if supported else Refusal.NOT_SUPPORTED

    def _answered(self, event: SensorEvent, error: SensorError | None) -> None:
        if self.preset_request is not None:
            self.preset_request = None
            self._answer = (event, error)

    def step(
        self, g1_stw: int | None, position: int, now: int, *, valid: bool = True, error: SensorError | None = None
    ) -> tuple[int, int, int]:
        """One cycle; returns G1_ZSW, G1_XIST1 and G1_XIST2.

        ``g1_stw``: None without a PLC; then nothing is requested, and a request that is present when the PLC returns is no
        edge. ``position``: in measuring units; ignored if not ``valid``. ``now``: monotonic nanoseconds. ``error``: present
        error. A position that becomes invalid is a sensor group error.
        """
        word = 0 if g1_stw is None else g1_stw & _EVERYTHING
        edges = word & ~self._previous
        self._previous = _EVERYTHING if g1_stw is None else word
        if error is None and not valid and self._position is not None:
            error = SensorError.SENSOR_GROUP
        measuring, measured = self.measuring, 0
        if measuring is None:
            if error is None and word & _COMMAND:
                error = SensorError.COMMAND_NOT_SUPPORTED
        elif word & _COMMAND or measuring.busy:
            measured = measuring.step(word)
            refusal = measuring.refusal or self._refused
            if error is None and refusal is not None:
                error = REFUSAL_ERRORS[refusal, measuring.on_the_fly]
        self._refused = None
        self._process_events(word, edges, error, position if valid else None, now)
        if valid:
            self._follow(position, now)
        state = self.state
        status = SENSOR_STATUS[state]
        if measuring is not None and state not in MEASURING:
            measuring.cancel()
            measured = 0
        status |= measured
        if state in IN_ERROR:
            return status, self._count & 0xFFFF_FFFF, int(self.error or 0)
        if measuring is not None and measuring.value is not None:
            return status, self._count & 0xFFFF_FFFF, measuring.value & 0xFFFF_FFFF
        if state in MEASURING and word & _ABSOLUTE and valid:
            return status | _ABSOLUTE_VALID, self._count & 0xFFFF_FFFF, position & 0xFFFF_FFFF
        return status, self._count & 0xFFFF_FFFF, 0

    # -- the state machine --------------------------------------------------------------------------------------------

    def _process_events(self, word: int, edges: int, error: SensorError | None, position: int | None, now: int) -> None:
        until = self._jump_until
        if until is None and self.preset_request is None:
            until = self._jump_until = now + self.settle_ns
            self._answered_at = self._count
        if self._answer is not None:
            event, failure = self._answer
            # G1_ZSW.12 must not be set together with the old position.
            if event is SensorEvent.FAILED or self._has_preset():
                self._transition(event, failure)
            elif until is not None and now >= until:
                self.ineffective = self._jump
                self._transition(SensorEvent.FAILED, SensorError.MEMORY)
        if word & _PARK and self.state is not SensorState.PARKED:
            self._parked_until = now + PARKED_NS
        self._transition(SensorEvent.PARK if word & _PARK or now < self._parked_until else SensorEvent.UNPARK)
        acknowledged = edges & SENSOR_ACKNOWLEDGE and self._transition(SensorEvent.ACKNOWLEDGE)
        self.in_vain = error is not None and bool(acknowledged or self.in_vain)
        if not word & SENSOR_ACKNOWLEDGE:
            self._transition(SensorEvent.ACKNOWLEDGE_END)
        if error is not None:
            self._transition(SensorEvent.FAULT, error)
        if edges & _PRESET:
            value, relative = self.preset_value, bool(word & _RELATIVE)
            if not self.preset_supported or not (relative or 0 <= value < self._range):
                self._transition(SensorEvent.FAULT, SensorError.COMMAND_NOT_SUPPORTED)
            elif position is None:
                self._transition(SensorEvent.FAULT, SensorError.SENSOR_GROUP)
            elif self._transition(SensorEvent.PRESET):
                target = (value + (position if relative else 0)) % self._range
                self.preset_request = self._jump = PresetRequest(value, relative, target)
                self._jump_until = None
                self._asked_at, self._largest = self._count, 0
        elif not word & _PRESET:
            self._transition(SensorEvent.PRESET_END)

    def _transition(self, event: SensorEvent, error: SensorError | None = None) -> bool:
        """Make the transition of an event, if there is one."""
        state = TRANSITIONS.get((self.state, event))
        if state is None:
            return False
        if state is SensorState.ERROR:
            self.error = error
        if self.state is SensorState.PARKED:
            self._last = None
        self.state = state
        if state is not SensorState.PRESETTING:
            self.preset_request = self._answer = None
        return True

    # -- the position -------------------------------------------------------------------------------------------------

    def _follow(self, position: int, now: int) -> None:
        if self.state is SensorState.PARKED:
            return
        if self._jump_until is not None and now > self._jump_until:
            self._jump = None
        last = self._last
        self._last = position
        if last is None:
            if self._position is None:
                self._count = position
            self._shift = position - self._count
        else:
            moved = self._wrapped(position - last)
            jump = self._jump
            if jump is not None:
                # Two interpretations are possible: motion, or the jump plus the rest of the step. Take the one nearer to the
                # last motion.
                rest = self._wrapped(position - jump.position)
                differs = abs(moved - rest) > self._largest
                if differs and self._surprise(rest) < self._surprise(moved):
                    self._jump = None
                    self._shift = position - self._count - rest
                    moved = rest
                self._largest = max(self._largest, abs(moved))
            self._count += moved
            self._moved = moved or self._moved
        self._position = position

    def _surprise(self, moved: int) -> int:
        """The difference of a motion to the last one, or to none: a position need not arrive in each cycle."""
        return min(abs(moved), abs(moved - self._moved))

    def _has_preset(self) -> bool:
        """Whether the jump was seen, or the preset is where the shaft was between request and answer: nothing would jump."""
        if self._jump is None:
            return True
        turned = self._answered_at - self._asked_at
        place = self._wrapped(self._jump.position - self._shift - self._asked_at)
        near = _NEAR_STEPS * self._largest
        return min(0, turned) - near <= place <= max(0, turned) + near

    def _wrapped(self, difference: int) -> int:
        """The shortest way round the total range."""
        half = self._range // 2
        return (difference + half) % self._range - half


class EncoderControl:
    """STW2_ENC to ZSW2_ENC: control by PLC, latched fault with its acknowledge, warning, sign of life."""

    def __init__(self, sign_of_life: SignOfLife) -> None:
        self.sign_of_life = sign_of_life
        self.fault = False
        """ZSW2_ENC.3: stays until the cause is gone and the PLC acknowledged."""
        self.has_control = False
        """STW2_ENC.10: accept the PLC's other words."""
        self.acknowledged = False
        """A rising edge of STW2_ENC.7 came in this cycle."""
        self.in_vain = False
        """As ``SensorInterface.in_vain``."""
        self.unheard = False
        """The last edge of STW2_ENC.7 came with STW2_ENC.10 or before it, in a fault: it had no effect."""
        self._acknowledge_armed = False
        self._asked = 0

    def step(self, word: int | None, *, fault: bool, warning: bool) -> int:
        """One cycle: STW2_ENC (None without a PLC), a present fault or warning; returns ZSW2_ENC.

        An acknowledge that is present when the PLC connects, or takes control, is not an edge.
        """
        if word is None:
            self.sign_of_life.reset()
            life = 0
        else:
            life = self.sign_of_life.step(_CONTROLLER_SIGN_OF_LIFE.of(word))
        self.has_control = word is not None and bool(word & _CONTROL_BY_PLC)
        before, self._asked = self._asked, 0 if word is None else word & ENCODER_ACKNOWLEDGE
        asked = self.has_control and self._asked != 0
        self.acknowledged = asked and self._acknowledge_armed
        self._acknowledge_armed = self.has_control and not asked
        if self._asked and not before:
            self.unheard = not self.acknowledged
        self.unheard = self.unheard and self.fault
        self.in_vain = fault and (self.acknowledged or self.in_vain)
        if fault:
            self.fault = True
        elif self.acknowledged:
            self.fault = False
        status = _CONTROL_REQUESTED | life << _DEVICE_SIGN_OF_LIFE.position
        return status | (_FAULT if self.fault else 0) | (_WARNING if warning else 0)


def speed_normalisation(data_type: DataType, reference: Fraction | int) -> Normalisation:
    """NIST_A (N2) or NIST_B (N4) from a speed in measuring units per second; ``reference`` is 100 % in the same unit.

    ProfidriveError for another type or a reference that is not above 0.
    """
    limits = DataType.INTEGER32.integer_range
    if data_type is DataType.N2:
        return n2(reference, limits)
    if data_type is DataType.N4:
        return n4(reference, limits)
    raise ProfidriveError("speed data type", data_type.name, "N2 or N4")


def rotary_speed_reference(rpm: Fraction | int, units_per_revolution: int) -> Fraction:
    """100 % of NIST in measuring units per second: P60000 in 1/min, and the encoder's units per revolution."""
    return Fraction(rpm) * units_per_revolution / SECONDS_PER_MINUTE
