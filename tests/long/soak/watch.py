"""What the soak sees of one axis on the wires and at the shaft, for the safety rules; never with data of the gateway.

Every bound has the latency of the drive and of the network in addition.
"""

from __future__ import annotations

from typing import Final

from pdgw.base.durations import MS
from pdgw.ds301.communication import NmtState
from pdgw.dsp402.states import State
from pdgw.gateway.axis.settings import PlcLossReaction
from pdgw.gateway.axis.supervision.drive_events import POWERED
from pdgw.gateway.axis.telegrams import POSITIONER_TELEGRAM_NUMBERS
from pdgw.peers.drive import SimulatedDrive
from pdgw.peers.world import Member
from tests.long.rules import ENABLE, FAULTY, ZSW1_OPERATION, Seen, broken
from tests.long.soak.plan import AxisPlan
from tests.long.soak.words import Words, asked_share, is_off, is_on

STOP_BOUND_NS: Final = 1000 * MS
"""The drive's own heartbeat monitoring (300 ms), a quick stop from full speed (300 ms), and the cycles for detection."""
RAMP_BOUND_NS: Final = 2500 * MS
"""The same with the ramp of on_plc_loss = "ramp" from full speed."""
TRANSIENT_NS: Final = 400 * MS
"""Time without changes before displayed states are compared."""
HELD_NS: Final = 20 * MS
"""A controller without connection keeps an Enable Operation; SocketCAN cannot remove it. When the bus returns, the stop
follows within 10 ms (docs/safety.md), and the drive brakes for as long.
"""
RATED_RPM: Final = 3000
"""100 % of a speed: 6080h of the simulated motor."""
REACHED_RPM: Final = 90
"""Tolerance of "speed reached"."""
_STANDSTILL_RPM: Final = 1.0
_MOVES: Final = 0x047F
"""STW1 bits that enable the setpoint, with control by the PLC."""
_NO_OFF2: Final = 0x0002
_NO_OFF3: Final = 0x0004


class ViolationError(Exception):
    """A safety rule is violated."""


def require(name: str, seen: Seen, details: str) -> None:
    """ViolationError if what was seen breaks a rule."""
    for rule in broken(seen):
        raise ViolationError(f"{name}: {rule.sentence}: {details}")


class SoakAxis:
    """The drive of one axis and the commands of the PLC for it."""

    def __init__(self, index: int, plan: AxisPlan, drive: SimulatedDrive, member: Member, words: Words) -> None:
        self.index = index
        self.plan = plan
        self.drive = drive
        self.member = member
        """The drive's controller on the bus."""
        self.words = words
        self.starts = 0
        """Number of entries to operation."""
        self.good = False
        """The setpoints of the last frame are valid: PLC in RUN, IOPS GOOD."""
        self.in_force_ns = 0
        """How long a command stays valid without another one. An OFF that is valid at the end of a loss counts as an OFF
        after it.
        """
        self.reaction_ns = 0
        """Time from a loss or a report of the drive to the new Controlword, without the latency of the drive."""
        self.late_ns = plan.late_ms * MS
        now = drive.loop.now()
        self._off = self._on = self._armed = -1
        """When the last OFF and ON reached the gateway, and the last ON that followed an OFF after the last loss or fault.
        """
        self._asked = b""
        self._share: float | None = None
        """The speed setpoint that reached the gateway, as a share of 100 %."""
        self._asked_since = now
        self._stop_since: int | None = None
        """Start of an active OFF2 or OFF3,"""
        self._stops = 0
        """and which one (the bits of STW1 that are 0)."""
        self._uncertain = -TRANSIENT_NS
        """When the last frame came that the gateway may not use."""
        self._commanded = 0
        """Bits 0 to 3 of the last Controlword."""
        self._enabled = -1
        """When Enable Operation was sent last."""
        self._start_sent = -1
        """The same without those repeated before the gateway can know that the drive has left operation."""
        self._began = self._left = -1
        """When the drive entered and left operation last."""
        self._new_off_since = (0, "power on")
        self._previous = drive.model.state
        self._changed = now
        self._lost_since: int | None = None
        self._reached_since = now
        """Since when PLC, gateway and drive are connected."""
        self._apart_since: int | None = None
        """Since when the shaft does not turn with the speed setpoint that reached the gateway."""
        self._disturbed_until = 0
        drive.model.watchers.append(self._entered)

    @property
    def name(self) -> str:
        return f"axis {self.index + 1}"

    # -- events -------------------------------------------------------------------------------------------------------

    def require_new_off(self, why: str, since: int | None = None) -> None:
        """From now on, or from an earlier time, a start needs a new OFF and then an ON."""
        when = self.drive.loop.now() if since is None else since
        if when > self._new_off_since[0]:
            self._new_off_since = (when, why)
            if self._off < when - self.in_force_ns:
                self._armed = -1

    def change(self, words: Words) -> None:
        """The PLC uses another telegram for this axis."""
        words.commands = self.words.commands
        self.words = words
        self._asked = b""

    def disturbed(self) -> None:
        """The drive itself is disturbed now."""
        self._disturbed_until = self.drive.loop.now()

    def asked(self, now: int, setpoints: bytes, *, certain: bool) -> None:
        """A frame of the PLC has reached the gateway. ``setpoints``: those of this axis, the control word first.

        ``certain``: the network neither loses nor delays frames and no later frame came first, so that the gateway uses this
        one.
        """
        if not certain:
            self._uncertain = now
        if setpoints != self._asked:
            self._asked = setpoints
            self._asked_since = now
            half = self.words.telegram.setpoints
            self._share = asked_share(half.as_dict(half.decode(setpoints, 0)))
        word = int.from_bytes(setpoints[:2], "big")
        raw = self.words.raw
        if is_off(word, raw=raw):
            self._off = now
        elif is_on(word, raw=raw):
            self._on = now
            if self._off >= self._new_off_since[0] - self.in_force_ns and self._off >= 0:
                self._armed = now
        stops = ~word & (_NO_OFF2 | _NO_OFF3)
        if raw or not stops:
            self._stop_since = None
        else:
            if certain:
                self.require_new_off("OFF2 or OFF3")
            if self._stop_since is None or self._stops != stops:
                self._stop_since, self._stops = now, stops

    def controlword_in(self, can_id: int, data: bytes) -> int | None:
        """The Controlword in an RPDO, by the drive's mapping. None without one, or while the drive accepts no RPDOs."""
        node = self.drive.node
        # After power-on the drive has its own mapping until the gateway has configured it.
        pdo = node.pdos.received.get(can_id) if node.state is NmtState.OPERATIONAL else None
        if pdo is None or "controlword" not in pdo.attributes:
            return None
        at = 0
        for entry in pdo.entries:
            if entry.attribute == "controlword":
                break
            at += entry.type.bits // 8
        return int.from_bytes(data[at : at + 2], "little")

    def commanded(self, now: int, controlword: int) -> None:
        """The gateway sent a Controlword for the drive to its controller."""
        word = controlword & ENABLE
        before, self._commanded = self._commanded, word
        if word != ENABLE:
            return
        self._enabled = now
        if before != ENABLE or self._is_late(self._left):
            self._start_sent = now
        if before != ENABLE:
            asked = self._on >= 0 and now - self._on <= self.in_force_ns
            self._require(Seen(energizes=True, on=asked))

    def restarted(self) -> None:
        """Another gateway, without knowledge of the past, has started."""
        self._commanded = 0
        self.require_new_off("gateway restarted")

    def _entered(self, state: State) -> None:
        now = self.drive.loop.now()
        if state is State.OPERATION_ENABLED and self._previous is not State.OPERATION_ENABLED:
            self.starts += 1
            self._began = now
            since = self._new_off_since[0]
            energizes = self._start_sent > max(since, self._left) or self._still_enabled(since)
            self._require(Seen(energizes=energizes, released=self._armed >= 0))
        elif state in FAULTY:
            self.require_new_off("fault of the drive")
        if self._previous is State.OPERATION_ENABLED and state is not State.OPERATION_ENABLED:
            self._left = now
        self._previous = state
        self._changed = now

    def _still_enabled(self, since: int) -> bool:
        """Whether the gateway did not take an Enable Operation back in time that it sent before.

        The drive may execute such a command until then: its enable input was away for less than a cycle, for example, or a
        controller that was disconnected held the frame and the stop after it.
        """
        since = max(since, self._left, self._reached_since, self._disturbed_until)
        return self._is_late(since) and self._lost_since is None and self._commanded == ENABLE

    def _is_late(self, since: int) -> bool:
        """Whether the gateway can have reacted to an event of the drive at that time."""
        return self.drive.loop.now() - since > self.reaction_ns + self.late_ns

    def _require(self, seen: Seen) -> None:
        """ViolationError if a rule is broken, with what is known of the axis."""
        if not broken(seen):
            return
        since, why = self._new_off_since
        times = {"OFF": self._off, "ON": self._on, why: since, "loss": self._lost_since, "stop": self._stop_since}
        now, model = self.drive.loop.now(), self.drive.model
        ago = (f"{name} {(now - at) / MS:.0f} ms ago" for name, at in times.items() if at is not None and at >= 0)
        asked = "" if self._share is None else f" of {self._share * RATED_RPM:.0f}"
        require(
            self.name,
            seen,
            f"drive in {model.state.value} with {model.ramp.speed:.0f}{asked} rpm, Controlword {self._commanded:X}h, "
            f"ZSW1 {seen.zsw1:04X}h, {model.started} motions for {self.words.commands} orders, {', '.join(ago)}",
        )

    # -- what is seen -------------------------------------------------------------------------------------------------

    def check(self, now: int, *, reached: bool, zsw1: int | None) -> None:
        """Check all rules. ``reached``: PLC, gateway and drive are connected. ``zsw1``: what the PLC sees, None while it may
        change.
        """
        self.drive.node.catch_up(now)
        if self.drive.node.state is not NmtState.OPERATIONAL:
            self._commanded = 0  # it accepts no RPDOs
        self._measure(now)
        model, settled = self.drive.model, TRANSIENT_NS + self.late_ns
        seen = Seen(self._commanded)
        # A positioner starts blocks by itself, and jogs.
        seen.moves = self.words.telegram.number not in POSITIONER_TELEGRAM_NUMBERS
        seen.ordered = model.started <= self.words.commands
        if not reached:
            self._reached_since = now
            self._see_loss(now, seen)
        else:
            self._lost_since = None
            self._see_stop(now, seen)
            if zsw1 is not None and now - max(self._changed, self._disturbed_until) > settled:
                seen.state, seen.zsw1 = model.state, zsw1
                seen.operates = model.state is State.OPERATION_ENABLED
                seen.follows = now - self._asked_since <= settled or self._follows(now, zsw1)
        self._require(seen)

    def _see_loss(self, now: int, seen: Seen) -> None:
        """A drive that turns under power."""
        if self._lost_since is None:
            self._lost_since = now
        model = self.drive.model
        # By an Enable Operation that was sent before the gateway noticed the loss.
        held = now - self._began <= HELD_NS and self._enabled < self._lost_since + TRANSIENT_NS
        if model.state in POWERED and abs(model.ramp.speed) > _STANDSTILL_RPM and not held:
            seen.age = now - max(self._lost_since, self._disturbed_until)
        ramp = self.plan.on_plc_loss is PlcLossReaction.RAMP
        seen.bound = (RAMP_BOUND_NS if ramp else STOP_BOUND_NS) + 2 * self.late_ns

    def _see_stop(self, now: int, seen: Seen) -> None:
        """OFF2 and OFF3 are on the bus within the time in which a command is valid.

        A gateway that uses none of the frames has lost the PLC, and may stop a drive by ``on_plc_loss = "quick-stop"``.
        """
        if self._stop_since is None:
            return
        since = max(self._stop_since, self._disturbed_until, self._reached_since)
        if now - since > self.in_force_ns + TRANSIENT_NS:
            brakes = self.plan.on_plc_loss is PlcLossReaction.QUICK_STOP and now - self._uncertain <= TRANSIENT_NS
            seen.off2 = self._stops & _NO_OFF2 != 0 and not brakes
            seen.off3 = not seen.off2

    def _measure(self, now: int) -> None:
        """Compare the shaft with the speed setpoint that reached the gateway."""
        share = self._share
        if share is None or abs(self.drive.model.ramp.speed - share * RATED_RPM) <= REACHED_RPM:
            self._apart_since = None
        elif self._apart_since is None:
            self._apart_since = now

    def _follows(self, now: int, zsw1: int) -> bool:
        """Compare setpoint and shaft. A limit switch may just have stopped it."""
        word, apart = int.from_bytes(self._asked[:2], "big"), self._apart_since
        if apart is None or word & _MOVES != _MOVES or not zsw1 & ZSW1_OPERATION:
            return True
        return now - apart <= TRANSIENT_NS + self.late_ns
