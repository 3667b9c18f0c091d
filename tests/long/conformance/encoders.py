"""Every fault of a simulated encoder on the gateway: is its position marked, the fault reported, and the recovery automatic?

Source: docs/dsp406-encoder.md, docs/translation.md "Losses". Rules of all cases: no position is shown as good that is older
than the timeouts allow. A position error stays until the PLC acknowledges it. The shaft turns at constant speed, so that
each position has a known time. ``Device.SENSOR``: the same encoder as G1 of a drive's telegram 3.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import can

from pdgw.dsp402.states import State
from pdgw.dsp406.faults import ENCODER_FAULTS
from pdgw.dsp406.objects import OPERATING_PARAMETERS, RESOLUTION
from pdgw.durations import MS, SECOND
from pdgw.gateway.configuration.tables.encoder import EncoderConfig
from pdgw.gateway.objects.drive_object import DriveObject
from pdgw.gateway.objects.encoder import EncoderNode, EncoderObject
from pdgw.peers.encoder import SimulatedEncoder
from pdgw.peers.encoder.motion import Motion, still
from pdgw.profidrive.signals import signal
from tests.long.conformance.bench import (
    CHANNEL,
    CONFIGURES,
    CYCLE_MS,
    ENCODER_DO,
    QUIET_CYCLES,
    Activity,
    Bench,
    Case,
    Device,
    Reaction,
    Result,
)
from tests.long.conformance.drives import DriveBench

_NODE = 6
_UNITS_PER_SECOND = 4096
"""One revolution per second."""
_STALE_NS = 1000 * MS
"""Longest timeout of these cases (TPDO: 200 ms, SDO: 500 ms and a few rounds)."""
_CONTROL = signal("STW2_ENC").bit("CONTROL_BY_PLC").mask
_ACKNOWLEDGE = signal("STW2_ENC").bit("FAULT_ACKNOWLEDGE").mask
_FAULT = signal("ZSW2_ENC").bit("FAULT").mask
_WARNING = signal("ZSW2_ENC").bit("WARNING").mask
_REQUEST = signal("G1_STW").bit("REQUEST_ABSOLUTE").mask
_SENSOR_ACKNOWLEDGE = signal("G1_STW").bit("ERROR_ACKNOWLEDGE").mask
_VALID = signal("G1_ZSW").bit("ABSOLUTE_VALID").mask
_ERROR = signal("G1_ZSW").bit("ERROR").mask
_COMMISSIONING = (0x0006).to_bytes(2, "little")
"""6000h: scaling, which is the default, and commissioning diagnostics."""
_POSITION = "position"


def _cases(
    reaction: Reaction, numbers: tuple[int, ...], *faults: str, activity: Activity = Activity.SPEED
) -> tuple[Case, ...]:
    """The same case for several faults, with the encoder telegrams in turn."""
    return tuple(
        Case(fault, reaction, numbers, activity, telegram=81 + number % 4, device=Device.ENCODER)
        for number, fault in enumerate(faults)
    )


ENCODER_CASES: tuple[Case, ...] = (
    Case(
        "slow-sdo",
        Reaction.MEASURES,
        activity=Activity.START,
        values={"delay_ms": 10},
        telegram=81,
        device=Device.ENCODER,
    ),
    *_cases(Reaction.NEVER_GOOD, (121,), "sdo-timeout", "sdo-toggle-error", activity=Activity.START),
    *_cases(
        Reaction.NEVER_GOOD,
        (106,),
        "wrong-identity",
        "fixed-pdo-mapping",
        "mapping-abort",
        "heartbeat-stops",
        activity=Activity.START,
    ),
    Case(
        "object-missing",
        Reaction.NEVER_GOOD,
        (106,),
        Activity.START,
        {"index": RESOLUTION},
        telegram=83,
        device=Device.ENCODER,
    ),
    # 1016h: an encoder moves nothing that it could stop by monitoring the gateway.
    *_cases(Reaction.MEASURES, (), "object-missing", activity=Activity.START),
    # Then the position is read by SDO.
    Case("two-pdos", Reaction.MEASURES, (), Activity.START, {"pdos": 0}, telegram=81, device=Device.ENCODER),
    Case(
        "sdo-timeout",
        Reaction.LOSES,
        (101,),
        telegram=82,
        sdo_timeout_ms=100,
        device=Device.ENCODER,
        beside={"two-pdos": {"pdos": 0}},
    ),
    *_cases(Reaction.MEASURES, (), "sdo-timeout", "lost-pdos", "duplicated-pdos", "late-pdos"),
    Case("lost-pdos", Reaction.LOSES, (101,), values={"every": 1}, telegram=83, device=Device.ENCODER),
    *_cases(Reaction.LOSES, (101,), "heartbeat-stops", "bus-off"),
    Case("reboot", Reaction.LOSES, (105,), telegram=84, device=Device.ENCODER),
    *_cases(Reaction.FAULT, (10,), "emcy-burst"),
    Case("emcy-burst", Reaction.MEASURES, (10,), values={"register": 0}, telegram=84, device=Device.ENCODER),
    *_cases(Reaction.FAULT, (12,), "error-passive"),
    *_cases(Reaction.SENSOR_ERROR, (10,), "position-error", "memory"),
    *_cases(
        Reaction.FAULT,
        (10,),
        "input-current",
        "input-voltage",
        "temperature",
        "software",
        "monitoring",
        "external",
        "device-specific",
    ),
    *_cases(Reaction.MEASURES, (), "sensor-defect"),
    *_cases(Reaction.SENSOR_ERROR, (10,), "sensor-defect", activity=Activity.COMMISSIONING),
    *_cases(Reaction.WARNS, (), "frequency", "light", "watchdog", "operating-time", "battery", "reference-point"),
    *(
        Case(fault, Reaction.G1_ERROR, numbers, values=values, telegram=3, device=Device.SENSOR)
        for fault, numbers, values in (
            ("lost-pdos", (101,), {"every": 1}),
            ("heartbeat-stops", (101,), {}),
            ("reboot", (105,), {}),
            ("position-error", (10,), {}),
        )
    ),
    Case("wrong-identity", Reaction.G1_MISSING, (106,), Activity.START, telegram=3, device=Device.SENSOR),
)
"""At least one case for each fault of an encoder (checked by a test)."""


class _Sight:
    """The position as seen by a PLC, and its age. The shaft turns at constant speed from ``zero`` (monotonic ns) on."""

    def __init__(self, owner: DriveObject, zero: int | None) -> None:
        self._owner = owner
        self._zero = zero
        self.shown: list[str] = []
        """States of the position that were shown, without repetitions."""
        self.oldest = 0
        """Greatest age of a position shown as good, in nanoseconds."""

    def value(self, name: str) -> int:
        """An actual value, 0 if the telegram has none."""
        owner = self._owner
        names = owner.telegram.actuals.names
        return owner.actuals[names.index(name)] if name in names else 0

    @property
    def error(self) -> bool:
        return bool(self.value("G1_ZSW") & _ERROR)

    @property
    def fault(self) -> bool:
        return bool(self.value("ZSW2_ENC") & _FAULT)

    @property
    def warning(self) -> bool:
        return bool(self.value("ZSW2_ENC") & _WARNING)

    @property
    def measuring(self) -> bool:
        """Whether an absolute position without any fault is shown."""
        return self._owner.good and bool(self.value("G1_ZSW") & _VALID) and not self.error and not self.fault

    def _text(self) -> str:
        if not self._owner.good:
            return "IOPS BAD"
        if self.error:
            text = f"G1 error {self.value('G1_XIST2'):04X}h"
        else:
            text = _POSITION if self.value("G1_ZSW") & _VALID else "no absolute position"
        return text + (", fault" if self.fault else "") + (", warning" if self.warning else "")

    def look(self, now: int) -> None:
        """Record the present state; called after each cycle."""
        text = self._text()
        if text not in self.shown[-1:]:
            self.shown.append(text)
        if self._zero is not None and self._owner.good and self.value("G1_ZSW") & _VALID:
            measured = self._zero + self.value("G1_XIST2") * SECOND // _UNITS_PER_SECOND
            self.oldest = max(self.oldest, now - measured)


def _encoder(bench: Bench, telegram: int) -> tuple[EncoderObject, SimulatedEncoder, int | None]:
    """An encoder of the gateway, the simulated device, and the time of its position 0; None at standstill."""
    case = bench.case
    config = EncoderConfig(
        do_id=ENCODER_DO,
        node_id=_NODE,
        telegram=telegram,
        sdo_timeout_ms=case.sdo_timeout_ms,
    )
    loop = bench.loop
    zero = loop.now()
    stands = case.activity is Activity.COMMISSIONING
    motion: Motion = still(1.0) if stands else lambda _: (loop.now() - zero) / SECOND
    encoder = EncoderObject(config, EncoderNode(bench.network, [config], CYCLE_MS), telegram)
    return encoder, bench.world.encoder(CHANNEL, _NODE, powered=False, motions=[motion]), None if stands else zero


class _EncoderBench(Bench):
    """An encoder of the gateway, and a PLC that requests its absolute position."""

    def __init__(self, case: Case) -> None:
        super().__init__(case)
        self.encoder, self.simulated, zero = _encoder(self, case.telegram)
        self.objects.append(self.encoder)
        self.devices.append(self.simulated)
        self.sight = _Sight(self.encoder, zero)
        self.shown = self.sight.shown
        self.watchers.append(self.sight.look)
        self._stw, self._g1_stw = _CONTROL, _REQUEST

    def setpoints(self) -> Sequence[Sequence[int]]:
        return [(self._stw, self._g1_stw)]

    def acknowledge(self) -> None:
        """Acknowledge the fault and the sensor error."""
        self._stw, self._g1_stw = _CONTROL | _ACKNOWLEDGE, _REQUEST | _SENSOR_ACKNOWLEDGE
        self.cycles(3)
        self._stw, self._g1_stw = _CONTROL, _REQUEST
        self.cycles(3)

    def set_in(self) -> None:
        """Start the fault of the case and forget what was recorded before."""
        if self.case.activity is Activity.COMMISSIONING:
            written = self.encoder.client.submit(
                lambda client: client.sdo.write(OPERATING_PARAMETERS, 0, _COMMISSIONING)
            )
            self.until(written.done, "diagnostics switched on")
            written.result(0)
        self.sent.clear()
        del self.sight.shown[:-1]
        if self.case.activity is not Activity.START:
            self.misbehave()


def run_encoder_case(case: Case, result: Result) -> None:
    """Run one case of an encoder with telegrams 81 to 84 and store its result."""
    bench = _EncoderBench(case)
    with bench.running(result), _fresh(bench.sight, result):
        if case.reaction is Reaction.NEVER_GOOD:
            _never_good(bench, result)
        else:
            bench.until(lambda: bench.sight.measuring, "position")
            bench.set_in()
            if case.reaction in {Reaction.LOSES, Reaction.SENSOR_ERROR}:
                _invalid(bench, result)
            else:
                _goes_on(bench, result)
        if result.passed:
            bench.until(lambda: bench.sight.measuring, "position again")


@contextmanager
def _fresh(sight: _Sight, result: Result) -> Iterator[None]:
    """Check at the end of the steps, however they end, that no position shown as good was too old."""
    try:
        yield
    finally:
        result.require(sight.oldest <= _STALE_NS, f"a position {sight.oldest // MS} ms old was shown as good")


def _never_good(bench: _EncoderBench, result: Result) -> None:
    case = bench.case
    bench.until(lambda: bench.has_reported(case.numbers), f"fault {case.numbers}")
    bench.cycles(QUIET_CYCLES)
    bench.note(result)
    result.require(bench.sight.shown == ["IOPS BAD"], "values are shown as good")
    result.require(bench.sight.fault, "no fault in ZSW2_ENC")
    result.require(result.reason, "no reason is shown")
    bench.behave(restart=True)


def _goes_on(bench: _EncoderBench, result: Result) -> None:
    """The position stays good. A fault stays until it is acknowledged, a warning as long as its cause."""
    case, sight = bench.case, bench.sight
    if case.reaction is Reaction.WARNS:
        bench.until(lambda: sight.warning, "warning")
    if case.numbers:
        bench.until(lambda: bench.has_reported(case.numbers), f"number {case.numbers}")
    if case.reaction is Reaction.FAULT:
        bench.until(lambda: sight.fault, "fault in ZSW2_ENC")
        if case.fault in ENCODER_FAULTS:
            _acknowledge_in_vain(bench, result)
    bench.cycles(QUIET_CYCLES)
    bench.note(result)
    bench.behave()
    if case.reaction is Reaction.FAULT:
        _latched(bench, result)
    elif case.reaction is Reaction.WARNS:
        bench.until(lambda: not sight.warning, "end of the warning")
    bench.cycles(QUIET_CYCLES)
    result.require(
        all(text.startswith(_POSITION) for text in sight.shown), f"the position was not good: {'; '.join(sight.shown)}"
    )
    result.require(
        case.reaction is Reaction.FAULT or not any("fault" in text for text in sight.shown),
        "a fault is shown without need",
    )
    result.require(case.numbers or not bench.numbers(), f"unexpected fault numbers: {bench.numbers()}")


def _invalid(bench: _EncoderBench, result: Result) -> None:
    """The position is not good from the error until the PLC acknowledges it."""
    case, sight = bench.case, bench.sight
    if case.reaction is Reaction.LOSES:
        bench.until(lambda: not bench.encoder.good, "IOPS BAD")
        bench.until(lambda: bench.has_reported(case.numbers), f"fault {case.numbers}")
        bench.until(lambda: CONFIGURES in bench.sent, "configured again")
    else:
        bench.until(lambda: sight.error and sight.fault, "error in G1_ZSW and fault in ZSW2_ENC")
        bench.until(lambda: bench.has_reported(case.numbers), f"fault {case.numbers}")
        _acknowledge_in_vain(bench, result)
    bench.cycles(QUIET_CYCLES)
    bench.note(result)
    result.require(result.reason, "no reason is shown")
    bench.behave()
    bench.until(lambda: bench.encoder.good, "IOPS GOOD")
    _latched(bench, result)
    invalid = next(number for number, text in enumerate(result.shown) if not text.startswith(_POSITION))
    result.require(
        not any(text.startswith(_POSITION) for text in result.shown[invalid:]),
        f"the position was good again before an acknowledge: {'; '.join(result.shown)}",
    )


def _acknowledge_in_vain(bench: _EncoderBench, result: Result) -> None:
    """Acknowledge while the cause is still present: no effect."""
    bench.acknowledge()
    bench.cycles(3)
    result.require(bench.sight.fault, "an acknowledge ended the fault although its cause is present")


def _latched(bench: _EncoderBench, result: Result) -> None:
    """After its cause, the fault stays until the PLC acknowledges it."""
    bench.until(lambda: not bench.encoder.faulty, "end of the cause")
    bench.cycles(QUIET_CYCLES)
    result.require(bench.sight.fault, "the fault ended by itself")
    result.require(
        bench.case.reaction is Reaction.FAULT or bench.sight.error,
        "the error of the sensor ended by itself",
    )
    bench.acknowledge()
    bench.until(lambda: bench.sight.measuring, "acknowledged")
    bench.until(lambda: not bench.encoder.fault_log.entries()[0].number, "P947 acknowledged")


# -- as G1 of a drive -----------------------------------------------------------------------------------------------------


class _SensorBench(DriveBench):
    """A drive with telegram 3 whose G1 is an encoder of the gateway; the encoder has the fault."""

    def __init__(self, case: Case) -> None:
        super().__init__(case)
        self.encoder, self.simulated, zero = _encoder(self, 81)
        self.axis.connect_sensor(self.encoder, 0)
        self.objects.append(self.encoder)
        self.devices.insert(0, self.simulated)
        self.sight = _Sight(self.axis, zero)
        self.shown = self.sight.shown
        self.watchers.append(self.sight.look)
        self.values["G1_STW"] = _REQUEST

    @property
    def subject(self) -> DriveObject:
        return self.encoder

    def setpoints(self) -> Sequence[Sequence[int]]:
        return [*super().setpoints(), (_CONTROL, 0)]

    def command_of(self, message: can.Message) -> str:
        return ""  # the encoder gets only NMT


def run_sensor_case(case: Case, result: Result) -> None:
    """Run one case of an encoder that is G1 of a drive, and store its result."""
    bench = _SensorBench(case)
    sight = bench.sight
    with bench.running(result), _fresh(sight, result):
        bench.enable()
        bench.turn()
        if case.reaction is Reaction.G1_ERROR:
            bench.until(lambda: sight.measuring, "position")
        mark = len(bench.trace.states)
        bench.sent.clear()
        del sight.shown[:-1]
        if case.reaction is Reaction.G1_ERROR:
            bench.misbehave()
        bench.until(lambda: sight.error, "error in G1_ZSW")
        bench.until(lambda: bench.has_reported(case.numbers), f"fault {case.numbers}")
        bench.cycles(QUIET_CYCLES)
        bench.note(result)
        bench.behave(restart=case.reaction is Reaction.G1_MISSING)
        bench.until(lambda: bench.encoder.good and not bench.encoder.faulty, "encoder back")
        bench.cycles(QUIET_CYCLES)
        if case.reaction is Reaction.G1_ERROR:
            if not sight.error:
                result.failures.append("the error of the sensor ended by itself")
            bench.values["G1_STW"] = _REQUEST | _SENSOR_ACKNOWLEDGE
            bench.cycles(3)
            bench.values["G1_STW"] = _REQUEST
        bench.until(lambda: sight.measuring, "position again")
        result.stopped = bench.trace.stopped_by(mark, standing=False)
        result.require(
            not bench.trace.states[mark:] and bench.state() is State.OPERATION_ENABLED, "the drive left operation"
        )
        result.require("IOPS BAD" not in sight.shown, "IOPS of the drive was BAD")
        result.require(not bench.axis.faults, "the drive has a fault")
        bench.off()
        bench.until(bench.standing, "OFF obeyed")
