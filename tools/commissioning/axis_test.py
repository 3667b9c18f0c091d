"""First move of an axis without a PLC: slow, limited, supervised, and compared from NSOLL_A to the position.

The test acts as the PLC of its own gateway, which has this one axis with telegram 1. Power, interlock and stops are those of
the axis machine; the test adds reasons to stop earlier. It reads the position by SDO, so that it works with any drive that
has a speed mode.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from fractions import Fraction

from pdgw.base.durations import MS, SECOND, SECONDS_PER_MINUTE
from pdgw.ds301.aborts import CanopenError, SdoAbortedError, SdoCommunicationError
from pdgw.ds301.node.node import NodeStatus
from pdgw.dsp402.drive_type import POSITIONS, DriveType, Quantity, Scaling
from pdgw.dsp402.objects import POSITION_ACTUAL
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.base.platform import Platform
from pdgw.gateway.commissioning.supervisions import Measured
from pdgw.gateway.commissioning.telegram_check import lacks
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.environment import TransportConfig
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.peers.plc.exchange.plc import Plc
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import telegram
from pdgw.tools.commissioning.chain_comparison import Measurement, compare, compare_turns, rpm
from pdgw.tools.commissioning.device_times import DeviceTimes

TELEGRAM = 1
_CYCLE_NS = 10 * MS
_WATCHDOG_FACTOR = 100
"""Watchdog in cycles. It may be long because PLC and gateway are one process; the drive's heartbeat monitoring guards this
process.
"""
_LISTEN_NS = SECOND
"""Listening time for another PLC, which sends more often than this."""
_ONLINE_NS = 60 * SECOND
_POWER_NS = 15 * SECOND
"""Longest time between two operating states. A brake may have to open."""
_TYPING_NS = 120 * SECOND
_SETTLING_NS = 10 * SECOND
"""Longest time between two speeds, with the drive's own ramps."""
_SDO_NS = 2 * SECOND
_AT_ONCE_NS = 20 * MS
"""Longest SDO transfer whose position has an exact enough time."""
_READINGS = 5
_CREEP = Fraction(1, 4)
"""Part of the requested speed that is tested first, so that a fault shows at low speed."""
_SHORTEST_NS = 500 * MS
"""Shortest measurement. The uncertainty of an SDO, some milliseconds, is small in comparison."""
_STEADY = Fraction(10, 100)
_STILL = Fraction(25, 10_000)
"""Speeds below this part of 100 % count as standstill."""
TURNS = "the number of turns"
"""The input requested after the move."""
_TOO_FAR, _MARGIN = Fraction(3, 2), Fraction(1, 10)
"""Greatest position change: this multiple of the commanded turns, plus this margin in turns."""
_NSOLL, _STW1, _NIST, _ZSW1 = map(signal, ("NSOLL_A", "STW1", "NIST_A", "ZSW1"))
_QUICK_STOP = _STW1.word("NO_COAST_STOP", "CONTROL_BY_PLC")
"""Controlword of OFF3."""
_OFF = _STW1.word(
    "NO_COAST_STOP",
    "NO_QUICK_STOP",
    "ENABLE_OPERATION",
    "ENABLE_RAMP_GENERATOR",
    "UNFREEZE_RAMP_GENERATOR",
    "ENABLE_SETPOINT",
    "CONTROL_BY_PLC",
)
_ON = _OFF | _STW1.bit("ON").mask
_READY, _ENABLED = _ZSW1.bit("READY_TO_SWITCH_ON").mask, _ZSW1.bit("OPERATION_ENABLED").mask
_INHIBITED = _ZSW1.bit("SWITCHING_ON_INHIBITED").mask


class AxisTestError(Exception):
    """An unexpected state. The drive is stopped; the text names the cause."""


class InterruptError(AxisTestError):
    """The user has interrupted the test."""


@dataclass(frozen=True, slots=True)
class Choices:
    """``percent``: speed in % of NSOLL's 100 %, negative for the other direction. ``turns``: motor turns at that speed."""

    percent: Fraction = Fraction(2)
    turns: Fraction = Fraction(2)


@dataclass(slots=True)
class Outcome:
    """``passed``: the drive turned as commanded. A factor is measured divided by commanded, ideally 1."""

    passed: bool = False
    interrupted: bool = False
    abort_reason: str = ""
    """Why the drive was stopped, if it was."""
    speed_factor: Fraction | None = None
    """From 606Ch."""
    position_factor: Fraction | None = None
    """From 6064h over time; None without 6064h or when its unit is unknown."""
    moved: int | None = None
    """Change of 6064h from the first to the last standstill."""
    confirmed: bool = False
    """A person has confirmed that the shaft made the commanded turns."""
    scaling: Scaling | None = None
    """The scaling that was tested."""
    serial_number: int = 0
    """Serial number of the tested drive (1018h/4)."""


def configuration(config: GatewayConfig, do_id: int) -> GatewayConfig:
    """Configure the axis alone with telegram 1, on a link inside this process. GatewayError when the axis is missing."""
    axis = next((item for item in config.axis if item.do_id == do_id), None)
    if axis is None:
        raise GatewayError(f"DO {do_id}: not an axis, allowed: {[item.do_id for item in config.axis]}")
    alone = axis.model_copy(update={"telegram": TELEGRAM, "g1": None, "can": None, "sync": False})
    transport = TransportConfig(
        cyclic_port=0,
        acyclic_port=0,
        status_port=0,
        cycle_time_ms=_CYCLE_NS / MS,
        watchdog_factor=_WATCHDOG_FACTOR,
    )
    return GatewayConfig(can=(config.bus_of(axis),), axis=(alone,), transport=transport)


class AxisTest:
    """The test; ``run`` is a task on the platform's loop.

    ``report`` prints a line. ``confirm`` gets the text that the user must type, and calls back on the loop with the typed
    text; ``TURNS`` requests the number of turns that the user saw.
    """

    def __init__(
        self,
        config: GatewayConfig,
        do_id: int,
        platform: Platform,
        report: Callable[[str], None],
        confirm: Callable[[str, Callable[[str], None]], None],
        choices: Choices,
    ) -> None:
        self.config = configuration(config, do_id)
        self.outcome = Outcome()
        self._do_id = do_id
        self._required_input = f"turn {do_id}"
        self._transport = config.transport
        self._platform = platform
        self._loop = platform.loop
        self._report = report
        self._confirm = confirm
        self._choices = choices
        self._direction = 1 if choices.percent > 0 else -1
        self._at_end = ExitStack()
        self._interrupted = False
        self._other_plc = ""
        self._begun: int | None = None
        """Position before the first move."""
        self._raw: int | None = None
        """Last raw value of 6064h. ``_way`` continues across its overflow."""
        self._way = 0
        self._still = Fraction(0)
        """Velocities up to this count as standstill."""
        self._commanded = Fraction(0)
        """Commanded turns until ``_watched_at``."""
        self._watched_at = 0

    def interrupt(self) -> None:
        """Stop the drive and end the test (Ctrl-C). Called on the loop's thread."""
        self._interrupted = True

    # -- the sequence ---------------------------------------------------------------------------------------------------

    def run(self) -> Outcome:
        """Run the test. GatewayError or CanopenError when it cannot start: no interface, or a gateway, PLC or other master
        is active.
        """
        with self._at_end:
            self._watch_for_plc()
            self._loop.sleep(_LISTEN_NS)
            if self._other_plc:
                raise GatewayError(f"a PLC sends frames from {self._other_plc}: switch it off or unplug it")
            daemon = self._daemon = Daemon(self.config, self._platform)
            self._axis = daemon.axes[0]
            port = self._platform.open_udp("127.0.0.1", 0, "axis test")
            self._plc = Plc(self._loop, port, daemon.address, [telegram(TELEGRAM)], _CYCLE_NS)
            self._at_end.callback(self._plc.stop)
            self._times = times = DeviceTimes(self._axis.drive)
            self._axis.drive.network.listeners.append(lambda message: times.see(message, self._loop.now()))
            daemon.start()
            try:
                self._run_steps()
            except AxisTestError as error:
                self.outcome.passed = False
                self.outcome.interrupted = isinstance(error, InterruptError)
                self.outcome.abort_reason = str(error)
                self._report(f"stopped: {error}")
                self._stop(_QUICK_STOP)
            finally:
                daemon.stop()
                daemon.stopped.wait()
            if daemon.failure is not None:
                raise daemon.failure
        return self.outcome

    def _run_steps(self) -> None:
        drive = self._bring_up()
        self._announce(drive)
        self._await_confirmation()
        self._plc.start()
        self._power_up()
        self._begun = self._position()
        self._watched_at = self._loop.now()
        self._compare(drive, self._hold(drive, self._choices.percent * _CREEP))
        if self.outcome.passed:
            self._compare(drive, self._hold(drive, self._choices.percent))
        else:
            self._report("the test does not turn it faster")
        speed, begun = abs(self._axis.drive.feedback.velocity_actual), self._loop.now()
        self._command(_ON)
        self._wait(self._at_standstill, _SETTLING_NS, "standstill")
        braked = (self._loop.now() - begun) * drive.scaling.reference(Quantity.SPEED)
        self._times.add(Measured.BRAKES, int(braked / max(1, speed)))
        turns = self._show_way(drive)
        self._stop(_OFF)
        self._show_times()
        if self.outcome.passed:
            self._ask_for_turns(drive, turns)

    # -- no other PLC ---------------------------------------------------------------------------------------------------

    def _watch_for_plc(self) -> None:
        """Occupy the port that a PLC sends to. This detects a PLC and prevents the start of another gateway."""
        transport = self._transport
        if transport.type != "udp":
            return  # on PROFINET, a running gateway is detected by its CAN frames
        port = self._platform.open_udp(
            str(transport.listen), transport.cyclic_port, "cyclic port; is a gateway running?"
        )
        self._at_end.callback(port.close)

        def came() -> None:
            while (datagram := port.receive()) is not None:
                self._other_plc = "{}:{}".format(*datagram[1])

        port.start(came)

    # -- before it moves ------------------------------------------------------------------------------------------------

    def _bring_up(self) -> DriveType:
        client = self._axis.drive

        def decided() -> bool:
            return client.status in {NodeStatus.ONLINE, NodeStatus.REFUSED}

        self._wait(decided, _ONLINE_NS, "the drive is online")
        drive = client.drive_type
        if client.status is not NodeStatus.ONLINE or drive is None:
            raise AxisTestError(f"DO {self._do_id}, {client.status.value}: {client.status_text}")
        place = f"DO {self._do_id}, node {self.config.axis[0].node_id}"
        self._report(f"{place}: {drive.name}" + (f", family {drive.family}" if drive.family else ""))
        for line in drive.scaling.lines:
            self._report(f"  {line}")
        refusal = lacks(drive, telegram(TELEGRAM))
        if refusal:
            raise AxisTestError(refusal)
        self._still = max(Fraction(2), drive.scaling.reference(Quantity.SPEED) * _STILL)
        return drive

    def _announce(self, drive: DriveType) -> None:
        full = rpm(drive, drive.scaling.reference(Quantity.SPEED)) * self._choices.percent / 100
        self._report(
            f"It will turn at {float(full * _CREEP):g} rpm of the motor. If that is correct, it will turn at "
            f"{float(full):g} rpm ({float(self._choices.percent):g} %) for {float(self._choices.turns):g} turns."
        )
        self._report("Make sure that brake, coupling and machine allow this. A person must be at the emergency stop.")

    def _await_confirmation(self) -> None:
        typed: list[str] = []
        self._confirm(self._required_input, typed.append)
        self._wait(lambda: typed, _TYPING_NS, "an input")
        if typed[0].strip() != self._required_input:
            raise AxisTestError(f"not confirmed: the input {typed[0].strip()!r} is not {self._required_input!r}")

    # -- the PLC's part -------------------------------------------------------------------------------------------------

    def _command(self, word: int, wire: int = 0) -> None:
        self._plc.set(0, {_STW1.name: word, _NSOLL.name: wire})

    def _shows(self, bit: int) -> bool:
        """Whether the gateway's ZSW1 has a bit set, and switching on is not inhibited."""
        actuals = self._plc.actuals[0]
        return actuals is not None and bool(actuals[_ZSW1.name] & bit) and not actuals[_ZSW1.name] & _INHIBITED

    def _power_up(self) -> None:
        for word, bit, what in ((_OFF, _READY, "ready to switch on"), (_ON, _ENABLED, "in operation")):
            self._command(word)
            self._wait(lambda bit=bit: self._shows(bit), _POWER_NS, f"the drive is {what}")  # type: ignore[misc]

    def _stop(self, word: int) -> None:
        """Remove power by OFF1 or OFF3. The axis machine supervises the stop and escalates if the drive does not follow."""
        self._command(word)
        end = self._loop.now() + _POWER_NS
        while self._axis.powered and not self._daemon.stopped.is_set() and self._loop.now() < end:
            self._loop.sleep(_CYCLE_NS)
        ignored = any(record.number == FaultNumber.STOP_IGNORED for record in self._axis.faults)
        if ignored or self._axis.powered:
            self.outcome.passed = False
            self._report("THE DRIVE DOES NOT STOP: USE THE EMERGENCY STOP")

    # -- while it moves -------------------------------------------------------------------------------------------------

    def _hold(self, drive: DriveType, percent: Fraction) -> Measurement:
        """Turn at a speed for a limited distance and measure."""
        axis = self._axis
        wire = _NSOLL.raw(float(percent))
        self._command(_ON, wire)
        self._wait(lambda: self._follows_speed(drive), _SETTLING_NS, "the speed was reached", drive)
        target = axis.outputs.command.target_velocity
        speed = abs(rpm(drive, target))
        share = 1 if percent == self._choices.percent else _CREEP
        duration = max(_SHORTEST_NS, int(self._choices.turns * share / (speed / SECONDS_PER_MINUTE) * SECOND))
        begun, first = self._timed_position(drive)
        last, ended, velocities = first, begun, [axis.drive.feedback.velocity_actual]
        while ended - begun < duration:
            ended, last = self._timed_position(drive)
            velocities.append(axis.drive.feedback.velocity_actual)
        actuals = self._plc.actuals[0]
        return Measurement(
            wire,
            target,
            Fraction(sum(velocities), len(velocities)),
            0 if actuals is None else actuals[_NIST.name],
            Fraction(ended - begun, SECOND),
            None if first is None or last is None else last - first,
        )

    def _follows_speed(self, drive: DriveType) -> bool:
        target, velocity = self._axis.outputs.command.target_velocity, self._axis.drive.feedback.velocity_actual
        expected = (
            drive.scaling.reference(Quantity.SPEED) * self._plc.endpoint.setpoints[0][_NSOLL.name] / _NSOLL.raw(100)
        )
        if expected and abs(expected) < 1:
            raise AxisTestError(
                f"60FFh cannot be {float(expected):g}: the speed is below one unit, choose a higher --percent"
            )
        near = max(Fraction(2), abs(target) * _STEADY)
        return bool(target) and abs(target - expected) <= 1 and abs(velocity - target) <= near

    def _at_standstill(self) -> bool:
        return abs(self._axis.drive.feedback.velocity_actual) <= self._still

    def _wait(self, condition: Callable[[], object], limit: int, what: str, drive: DriveType | None = None) -> None:
        """Wait until a condition is true. ``drive``: supervise this turning drive meanwhile."""
        end = self._loop.now() + limit
        while not condition():
            if self._loop.now() > end:
                raise AxisTestError(f"not within {limit / SECOND:g} s: {what}; {self._why()}")
            if drive is None:
                self._undisturbed()
                self._loop.sleep(_CYCLE_NS)
            else:
                self._watch(drive)
                self._position()

    def _undisturbed(self) -> None:
        """Raise AxisTestError when another PLC sends or the gateway failed, InterruptError when the user interrupts."""
        if self._interrupted:
            raise InterruptError("interrupted")
        if self._other_plc:
            raise AxisTestError(f"a PLC sends frames from {self._other_plc}")
        if self._daemon.failure is not None:
            raise AxisTestError(str(self._daemon.failure))

    def _watch(self, drive: DriveType) -> None:
        """Wait one cycle and check the turning drive. AxisTestError when it leaves operation, reverses or runs away."""
        self._loop.sleep(_CYCLE_NS)
        self._undisturbed()
        if not self._shows(_ENABLED):
            raise AxisTestError(f"the drive has left operation: {self._why()}")
        target, velocity = self._axis.outputs.command.target_velocity, self._axis.drive.feedback.velocity_actual
        now = self._loop.now()
        self._commanded += abs(rpm(drive, target)) * (now - self._watched_at) / (SECONDS_PER_MINUTE * SECOND)
        self._watched_at = now
        seen = f"606Ch is {velocity} with 60FFh {target}"
        slack = max(self._still, Fraction(abs(target), 4))
        if velocity * self._direction < -slack:
            raise AxisTestError(f"it turns in the wrong direction: {seen}")
        if abs(velocity) > 2 * abs(target) and abs(velocity) > 2 * slack:
            raise AxisTestError(f"it runs away: {seen}")

    def _timed_position(self, drive: DriveType) -> tuple[int, int | None]:
        """Read a position and its time. If an SDO is slow, use the fastest of several readings."""
        shortest, moment, position = _SDO_NS, 0, None
        for _ in range(_READINGS):
            self._watch(drive)
            before = self._loop.now()
            read = self._position()
            took = self._loop.now() - before
            if took < shortest or not moment:
                shortest, moment, position = took, before + took // 2, read
            if took <= _AT_ONCE_NS:
                break
        return moment, position

    def _position(self) -> int | None:
        """Distance of 6064h in increments; None for a drive without it. AxisTestError when it exceeds the commanded distance."""
        try:
            raw = self._loop.result(
                self._axis.drive.submit(lambda node: node.sdo.read_number(POSITION_ACTUAL, signed=True)), _SDO_NS
            )
        except SdoAbortedError:
            return None
        except (CanopenError, SdoCommunicationError, TimeoutError) as error:
            raise AxisTestError(f"6064h cannot be read: {error}") from error
        drive = self._axis.drive.drive_type
        assert drive is not None
        counts = drive.scaling.counts_per_revolution
        step = 0 if self._raw is None else raw - self._raw
        self._raw = raw
        self._way += min((step + turn for turn in _turns_over(drive)), key=abs)
        if self._begun is not None and counts is not None:
            moved = self._way - self._begun
            turns = Fraction(moved) / counts * self._direction
            if not -_MARGIN <= turns <= self._commanded * _TOO_FAR + _MARGIN:
                raise AxisTestError(
                    f"6064h moved by {moved} = {float(Fraction(moved) / counts):.2f} turns, commanded were "
                    f"{float(self._commanded * self._direction):.2f} until now: wrong direction, wrong units, or "
                    "runaway"
                )
        return self._way

    def _why(self) -> str:
        """The reason and last faults as the gateway and the drive report them."""
        axis = self._axis
        faults = [record.text for record in tuple(axis.faults)[-2:]]
        velocity = axis.drive.feedback.velocity_actual
        reason = axis.reason.value if axis.reason else f"60FFh {axis.outputs.command.target_velocity}, 606Ch {velocity}"
        return "; ".join((reason, *faults))

    # -- the result -----------------------------------------------------------------------------------------------------

    def _compare(self, drive: DriveType, held: Measurement) -> None:
        comparison = compare(drive, held)
        for line in comparison.lines:
            self._report(line)
        outcome = self.outcome
        outcome.passed = comparison.passed
        outcome.speed_factor, outcome.position_factor = comparison.speed_factor, comparison.position_factor

    def _show_way(self, drive: DriveType) -> Fraction:
        """Print how far 6064h moved. Return the turns that the shaft must have made."""
        end, counts = self._position(), drive.scaling.counts_per_revolution
        if end is None or self._begun is None:
            return self._commanded
        moved = self.outcome.moved = end - self._begun
        self._report(f"in all     6064h {moved:+d}")
        return self._commanded if counts is None else abs(Fraction(moved) / counts)

    def _show_times(self) -> None:
        """Print what the drive needed of the times that the gateway gives it."""
        self._report("The times of this drive, and the limits of the gateway:")
        for line in self._times.lines(self._axis.drive.settings, self._axis.machine.settings):
            self._report(line)

    def _ask_for_turns(self, drive: DriveType, turns: Fraction) -> None:
        """Ask a person for the number of turns: drive and gateway also agree when both have the same wrong resolution."""
        outcome, typed = self.outcome, list[str]()
        outcome.scaling, outcome.serial_number = drive.scaling, self._axis.drive.serial_number
        self._report("Only a person can check the shaft. How many turns did the mark on the motor shaft make?")
        self._confirm(TURNS, typed.append)
        try:
            self._wait(lambda: typed, _TYPING_NS, "an input")
        except InterruptError:
            raise
        except AxisTestError as error:
            self._report(f"not verified: {error}")
            return
        seen, wrong = compare_turns(typed[0], turns)
        outcome.confirmed = seen and not wrong
        outcome.passed = not wrong
        if not outcome.confirmed:
            self._report(wrong or "not verified: the number of turns is missing")


def _turns_over(drive: DriveType) -> tuple[int, ...]:
    """Possible jumps of a position at its overflow. Between two readings it moves by much less."""
    spans = {POSITIONS, drive.scaling.position_span}
    return (0, *spans, *(-span for span in spans))
