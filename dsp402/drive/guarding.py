"""Guarding in both directions, and the SDO writes that it requires: the drive stops when the gateway dies, and the reverse.

The first available method is used. Source: docs/translation.md "Losses"; CiA DS 301 V4.02 chapters 7.2.8.3 (node guarding, life
guarding, heartbeat) and 7.5.2.35 (event timer of an RPDO), CiA 402 (6007h). A device that sends heartbeats answers no node
guarding: with life guarding, 1017h is 0."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial

from pdgw.base.durations import SECOND, US
from pdgw.ds301.aborts import NOT_THERE, Abort, CanopenError, SdoAbortedError, abort_text
from pdgw.ds301.communication import (
    CONSUMER_HEARTBEAT,
    GUARD_TIME,
    LIFE_TIME_FACTOR,
    NODE_IDS,
    PRODUCER_HEARTBEAT,
    SYNC_PERIOD,
)
from pdgw.ds301.configuration import EVENT_TIMER, SdoStep
from pdgw.ds301.objects import CanType
from pdgw.dsp402.drive_type import Dsp402Error
from pdgw.dsp402.objects import ABORT_OPTION, INTERPOLATION_TIME


def write_interpolation(period_us: int, write_checked: Callable[[SdoStep], int], held: int) -> None:
    """60C2h for a period: a count of 1 to 255 and a power of ten of a second, ``held`` or another one that the drive takes.

    Each is read back. Dsp402Error for a period that no power of the drive fits.
    """
    refusal = ""
    for exponent in dict.fromkeys((-3, held, -4, -5, -6)):
        count = Fraction(period_us, SECOND // US) / Fraction(10) ** exponent
        if count.denominator != 1 or not 1 <= count <= 0xFF:
            continue
        try:
            if exponent != held:
                write_checked(SdoStep(INTERPOLATION_TIME, 2, CanType.I8, exponent, "power of ten of 60C2h"))
            write_checked(SdoStep(INTERPOLATION_TIME, 1, CanType.U8, int(count), "interpolation time 60C2h"))
        except (CanopenError, SdoAbortedError) as error:
            refusal = f"; the drive refuses {count} * 10^{exponent} s ({error})"
        else:
            return
    raise Dsp402Error(
        "interpolation time 60C2h",
        f"{period_us} us",
        f"1 to 255 times its power of ten of a second{refusal or f' ({held})'}",
    )


def guard_steps(gateway_node_id: int, consumer_ms: int, producer_ms: int, abort_option: int) -> list[SdoStep]:
    """Heartbeat both ways and what the drive does when the gateway's stops; each is read back, a time as the drive rounds it.

    Dsp402Error when a time does not fit into its object (65535 ms) or the node-ID is none.
    """
    if gateway_node_id not in NODE_IDS:
        raise Dsp402Error("gateway node-ID", gateway_node_id, "1..127")
    if not 0 <= consumer_ms <= 0xFFFF:
        raise Dsp402Error("heartbeat consumer time", f"{consumer_ms} ms", "0..65535 ms")
    try:
        return [
            _time(
                CONSUMER_HEARTBEAT, 1, CanType.U32, gateway_node_id << 16 | consumer_ms, "the drive guards the gateway"
            ),
            SdoStep(ABORT_OPTION, 0, CanType.I16, abort_option, "reaction to a lost gateway"),
            _time(PRODUCER_HEARTBEAT, 0, CanType.U16, producer_ms, "the drive's heartbeat"),
        ]
    except CanopenError as error:
        raise Dsp402Error(error.field, error.value, error.allowed) from error


_time = partial(SdoStep, time=True)
_REACTIONS = {0: "nothing", 1: "malfunction", 2: "disable voltage", 3: "quick stop"}
"""Values of 6007h."""
_OWN_REACTION = "its own reaction, by default a malfunction (no 6007h)"
_RPDO_REFRESHES = 3
_TAKEN = "1016h: all entries have other nodes"
_UNGUARDED = "set allow_unguarded = true if something else stops the drive when the gateway fails"
_OUT_OF_RANGE = (Abort.VALUE_RANGE, Abort.VALUE_TOO_HIGH, Abort.VALUE_TOO_LOW)


@dataclass(frozen=True, slots=True)
class GuardTimes:
    """Times in milliseconds."""

    gateway_node_id: int
    heartbeat_ms: int
    heartbeat_factor: int
    rpdo_refresh_ms: int
    reaction: int
    """For 6007h."""
    control_index: int
    """Communication parameter of the RPDO with the Controlword."""
    sync_loss_periods: int = 0
    """Without SYNC, after which the drive's family stops in a cyclic synchronous mode; 0: not known to."""
    sync_period_us: int = 0
    """Time between two SYNC if the drive operates only in a mode with SYNC; else 0."""


@dataclass(frozen=True, slots=True)
class Guarding:
    """The selected guarding. ``text``: for the user. An empty ``refusal`` means that the drive stops."""

    text: str
    refusal: str = ""
    remedy: str = _UNGUARDED
    """What to do about a refusal."""
    heartbeat: bool = False
    """The drive sends heartbeats."""
    life_guarding: bool = False
    """The gateway must request the state of the drive periodically, and the drive answers."""
    rpdos: bool = False
    """The drive stops when the gateway's RPDO does not come any more."""
    sync: bool = False
    """The drive stops when the gateway's SYNC does not come any more."""
    entry: int = 1
    """Of 1016h, with the gateway's heartbeat."""


def guard(times: GuardTimes, write_checked: Callable[[SdoStep], int], read: Callable[[int, int], int]) -> Guarding:
    """Have the drive guard the gateway; for the node's task. Raises what ``write_checked`` raises but for refusals.

    ``write_checked`` returns the value that the drive holds.
    """
    return _by_sync(_by_service(times, write_checked, read), times, read)


def _by_service(
    times: GuardTimes, write_checked: Callable[[SdoStep], int], read: Callable[[int, int], int]
) -> Guarding:

    def try_write(step: SdoStep) -> str:
        """Write a value. The result is the object and why the drive rejects it, empty if it accepts it."""
        try:
            held[step.index] = write_checked(step)
        except CanopenError as error:
            return f"{step.index:04X}h: {error.value}"
        except SdoAbortedError as error:
            return f"{step.index:04X}h: {abort_text(error.code)}"
        return ""

    held: dict[int, int] = {}
    """What the drive has taken, by index."""
    limit = times.heartbeat_ms * times.heartbeat_factor
    consumer, option, producer = guard_steps(times.gateway_node_id, limit, times.heartbeat_ms, times.reaction)
    no_consumer, entry = _write_consumer(consumer, times.gateway_node_id, try_write, read)
    reaction, no_reaction = _write_reaction(option, try_write, read)
    no_producer = try_write(producer)
    if not no_consumer:
        life = "" if not no_producer else "; the gateway monitors the node by its TPDOs only"
        limit = held[CONSUMER_HEARTBEAT] & 0xFFFF
        text = f"the gateway's heartbeat (1016h, {limit} ms), then {reaction}{life}"
        beats = not no_producer and times.heartbeat_ms > 0
        return Guarding(text, no_reaction, heartbeat=beats, entry=entry)
    silent = bool(no_producer) or not try_write(replace(producer, value=0))
    life_steps = (
        _time(GUARD_TIME, 0, CanType.U16, times.heartbeat_ms, "guard time"),
        SdoStep(LIFE_TIME_FACTOR, 0, CanType.U8, times.heartbeat_factor, "life time factor"),
    )
    if silent and not any(map(try_write, life_steps)):
        limit = held[GUARD_TIME] * times.heartbeat_factor
        return Guarding(f"life guarding (100Ch, 100Dh, {limit} ms), then {reaction}", no_reaction, life_guarding=True)
    beats = not no_producer and times.heartbeat_ms > 0 and not try_write(producer)
    time_out = _RPDO_REFRESHES * times.rpdo_refresh_ms
    timer = _time(times.control_index, EVENT_TIMER, CanType.U16, time_out, "timeout of the RPDO with the Controlword")
    if not try_write(timer):
        text = f"the timeout of its RPDO ({times.control_index:04X}h/5, {held[timer.index]} ms), then {reaction}"
        return Guarding(text, no_reaction, heartbeat=beats, rpdos=True)
    return Guarding("nothing", no_consumer, _remedy(no_consumer, times, limit), heartbeat=beats)


def _write_consumer(
    step: SdoStep, node_id: int, try_write: Callable[[SdoStep], str], read: Callable[[int, int], int]
) -> tuple[str, int]:
    """Write the entry of 1016h with the gateway's node-ID, which may be there only once, else one without a node. Those of other
    nodes stay. Return why the drive rejects it, empty if it accepts it, and the entry."""
    try:
        entries = {number: read(CONSUMER_HEARTBEAT, number) for number in range(1, read(CONSUMER_HEARTBEAT, 0) + 1)}
    except SdoAbortedError:
        return try_write(step), step.subindex
    own = [number for number, value in entries.items() if value >> 16 & 0x7F == node_id]
    free = [number for number, value in entries.items() if not (value >> 16 & 0x7F and value & 0xFFFF)]
    refusal = _TAKEN
    for number in dict.fromkeys((*own, *free)):
        entry = replace(step, subindex=number)
        if not (refusal := try_write(entry)):
            return "", number
        # A device may take a new time only into an entry without a node.
        if number in own and not try_write(replace(entry, value=0)) and not (refusal := try_write(entry)):
            return "", number
    return refusal, step.subindex


def _remedy(refusal: str, times: GuardTimes, limit: int) -> str:
    if refusal == _TAKEN:
        return "write 0 to an entry of 1016h that is not needed any more, with the drive's own tool"
    if any(abort_text(code) in refusal for code in _OUT_OF_RANGE):
        return (
            f"set another heartbeat_ms than {times.heartbeat_ms}, for example {2 * times.heartbeat_ms} (the drive refuses "
            f"{limit} ms, {times.heartbeat_factor} times that), or another node_id of [can] than {times.gateway_node_id}"
        )
    return _UNGUARDED


def _by_sync(found: Guarding, times: GuardTimes, read: Callable[[int, int], int]) -> Guarding:
    """``found``, or the loss of SYNC where that is nothing and the drive holds the period."""
    if not (found.refusal and times.sync_loss_periods and times.sync_period_us):
        return found
    try:
        if read(SYNC_PERIOD, 0) != times.sync_period_us:
            return found
    except SdoAbortedError:
        return found
    text = f"the loss of SYNC ({times.sync_loss_periods} periods of {times.sync_period_us} us, 1006h), then its own reaction"
    return replace(found, text=text, refusal="", sync=True)


def _write_reaction(
    step: SdoStep, try_write: Callable[[SdoStep], str], read: Callable[[int, int], int]
) -> tuple[str, str]:
    """Write the reaction of the drive. Return its text, and why it has none; empty if it has one."""
    found, refusal = step.value, try_write(step)
    if refusal:
        try:
            found = read(step.index, step.subindex)
        except SdoAbortedError as error:
            if error.code in NOT_THERE:
                return _OWN_REACTION, ""
            return "an unknown reaction (6007h cannot be read)", abort_text(error.code)
    text = f"{_REACTIONS.get(found, 'a reaction of the manufacturer')} (6007h = {found})"
    return ("nothing (6007h = 0)", refusal) if refusal and found == 0 else (text, "")
