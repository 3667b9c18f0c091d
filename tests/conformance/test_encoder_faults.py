"""Every fault of a simulated encoder: is its position marked, the fault reported, and the recovery automatic?

Source: docs/devices.md, docs/translation.md "Losses". Rules of all cases: no position is shown as good that is older
than the timeouts allow. A position error stays until the PLC acknowledges it. The shaft turns at constant speed, so that
each position has a known time. ``Device.SENSOR``: the same encoder as G1 of a drive's telegram 3.
"""

from __future__ import annotations

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.dsp402.states import State
from pdgw.dsp406.encoder import EncoderClient
from pdgw.dsp406.objects import OPERATING_PARAMETERS
from pdgw.gateway.axis import encoder_machine
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.peers.encoder import SimulatedEncoder
from pdgw.peers.encoder.encoder_model import ENCODER_FAULTS
from pdgw.peers.encoder.motion import Motion, still
from pdgw.profidrive.encoder import EncoderControl
from pdgw.profidrive.signals import signal
from tests.conformance import rig as rigs
from tests.conformance.fault_cases import CONFIGURES, ENCODER_CASES, Activity, Case, Device, Reaction
from tests.conformance.rig import ENCODER_NODE, QUIET_CYCLES, DriveRig, Rig, drive, encoder
from tests.support.gateways.daemon import axis, configuration, running

_STALE_NS = 1000 * MS
"""Longest timeout of these cases (TPDO: 200 ms, SDO: 500 ms and a few rounds)."""
_UNITS_PER_SECOND = 4096
"""One revolution per second."""
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
_SHOWN = {
    Reaction.MEASURES: _POSITION,
    Reaction.WARNS: "position, warning",
    Reaction.FAULT: "position, fault",
    Reaction.SENSOR_ERROR: "G1 error",
    Reaction.LOSES: "IOPS BAD",
}
"""How a state begins that the PLC must see during the fault."""


class Sight:
    """The position as the PLC sees it, and its age. The shaft turns at constant speed from ``zero`` (monotonic ns) on."""

    def __init__(self, rig: Rig, zero: int | None) -> None:
        self.shown: list[str] = []
        """States of the position, without repetitions."""
        self.oldest = 0
        """Greatest age of a position shown as good, in nanoseconds."""
        self._rig = rig
        self._zero = zero
        rig.watchers.append(self._look)

    def value(self, name: str) -> int:
        """An actual value; 0 if the telegram has none, or while it is not valid."""
        return (self._rig.plc.actuals[0] or {}).get(name, 0)

    @property
    def good(self) -> bool:
        return self._rig.plc.actuals[0] is not None

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
    def absolute(self) -> bool:
        """Whether an absolute position is shown."""
        return bool(self.value("G1_ZSW") & _VALID) and not self.error

    @property
    def measuring(self) -> bool:
        """Whether an absolute position without any fault is shown."""
        return self.absolute and not self.fault

    def _text(self) -> str:
        if not self.good:
            return "IOPS BAD"
        if self.error:
            text = f"G1 error {self.value('G1_XIST2'):04X}h"
        else:
            text = _POSITION if self.value("G1_ZSW") & _VALID else "no absolute position"
        return text + (", fault" if self.fault else "") + (", warning" if self.warning else "")

    def _look(self) -> None:
        text = self._text()
        if text not in self.shown[-1:]:
            self.shown.append(text)
        if self._zero is not None and self.value("G1_ZSW") & _VALID:
            measured = self._zero + self.value("G1_XIST2") * SECOND // _UNITS_PER_SECOND
            self.oldest = max(self.oldest, self._rig.loop.now() - measured)
            assert self.oldest <= _STALE_NS, f"a position {self.oldest // MS} ms old was shown as good"


class EncoderRig(Rig):
    """An encoder as the first drive object, and a PLC that requests its absolute position."""

    def __init__(self, daemon: Daemon, case: Case) -> None:
        device, zero = _encoder(daemon, case)
        super().__init__(daemon, device)
        self.encoder = daemon.encoders[0]
        self.sight = Sight(self, zero)
        self.plc.set(0, {"STW2_ENC": _CONTROL, "G1_STW": _REQUEST})

    def acknowledge(self) -> None:
        """Acknowledge the fault and the sensor error."""
        self.plc.set(0, {"STW2_ENC": _CONTROL | _ACKNOWLEDGE, "G1_STW": _REQUEST | _SENSOR_ACKNOWLEDGE})
        self.cycles(3)
        self.plc.set(0, {"STW2_ENC": _CONTROL, "G1_STW": _REQUEST})
        self.cycles(3)


class SensorRig(DriveRig):
    """A drive with telegram 3 whose G1 is an encoder of the gateway; the encoder is the subject."""

    def __init__(self, daemon: Daemon, case: Case) -> None:
        super().__init__(daemon, drive(daemon))
        self.device.start()
        self.device, zero = _encoder(daemon, case)
        self.subject = self.encoder = daemon.encoders[0]
        self.sight = Sight(self, zero)
        self.plc.set(0, {"G1_STW": _REQUEST})
        self.plc.set(1, {"STW2_ENC": _CONTROL})


def _encoder(daemon: Daemon, case: Case) -> tuple[SimulatedEncoder, int | None]:
    """The encoder, powered off, and the time of its position 0; None at standstill."""
    loop = daemon.loop
    zero = loop.now()
    at_standstill = case.activity is Activity.COMMISSIONING
    motion: Motion = still(1.0) if at_standstill else lambda _: (loop.now() - zero) / SECOND
    return encoder(daemon, motion), None if at_standstill else zero


def _tables(case: Case, telegram: int) -> str:
    ids = f"do_id = {ENCODER_NODE}\nnode_id = {ENCODER_NODE}\n"
    return f"[[encoder]]\n{ids}telegram = {telegram}\nsdo_timeout_ms = {case.sdo_timeout_ms}\n"


@pytest.mark.parametrize("case", [case for case in ENCODER_CASES if case.device is Device.ENCODER], ids=str)
def test_gateway_reacts_to_each_fault_of_an_encoder(case: Case) -> None:
    with running(configuration(_tables(case, case.telegram))) as daemon:
        rig = EncoderRig(daemon, case)
        rig.power_on(case)
        if case.reaction is Reaction.NEVER_GOOD:
            _check_never_good(rig, case)
        else:
            rig.until(lambda: rig.sight.absolute, "position")
            _begin(rig, case)
            if case.reaction in {Reaction.LOSES, Reaction.SENSOR_ERROR}:
                _check_invalid(rig, case)
            else:
                _check_continues(rig, case)
        rig.until(lambda: rig.sight.measuring, "position again")


def _begin(rig: EncoderRig, case: Case) -> None:
    """Start the fault of this case, and delete the records from before it."""
    if case.activity is Activity.COMMISSIONING:
        written = rig.encoder.client.submit(lambda client: client.sdo.write(OPERATING_PARAMETERS, 0, _COMMISSIONING))
        rig.until(written.done, "diagnostics switched on")
        written.result(0)
    rig.sent.clear()
    del rig.sight.shown[:-1]
    if case.activity is not Activity.START:
        rig.start_fault(case.fault, case.values)


def _check_never_good(rig: EncoderRig, case: Case) -> None:
    rig.until(lambda: rig.has_reported(case.numbers), f"fault {case.numbers}")
    rig.cycles(QUIET_CYCLES)
    rig.check_reports(case)
    assert rig.sight.shown == ["IOPS BAD"]
    assert rig.reason
    rig.end_fault(restart=True)
    rig.until(lambda: rig.sight.good, "IOPS GOOD")
    rig.cycles(QUIET_CYCLES)
    assert rig.sight.fault, "the fault ended by itself"
    rig.acknowledge()


def _check_continues(rig: EncoderRig, case: Case) -> None:
    """The position stays good. A fault stays until it is acknowledged, a warning as long as its cause."""
    sight = rig.sight
    if case.reaction is Reaction.WARNS:
        rig.until(lambda: sight.warning, "warning")
    if case.reaction is Reaction.FAULT:
        rig.until(lambda: sight.fault, "fault in ZSW2_ENC")
        if case.fault in ENCODER_FAULTS:
            _acknowledge_in_vain(rig)
    _check_reports(rig, case)
    rig.end_fault()
    if case.reaction is Reaction.FAULT:
        _check_latch(rig, case)
    elif case.reaction is Reaction.WARNS:
        rig.until(lambda: not sight.warning, "end of the warning")
    rig.cycles(QUIET_CYCLES)
    assert all(text.startswith(_POSITION) for text in sight.shown), sight.shown
    assert case.reaction is Reaction.FAULT or not any("fault" in text for text in sight.shown), sight.shown
    assert case.numbers or not rig.numbers, f"unexpected fault numbers: {rig.numbers}"


def _check_invalid(rig: EncoderRig, case: Case) -> None:
    """The position is not good from the error until the PLC acknowledges it."""
    sight = rig.sight
    if case.reaction is Reaction.LOSES:
        rig.until(lambda: not sight.good, "IOPS BAD")
        rig.until(lambda: CONFIGURES in rig.sent, "configured again")
    else:
        rig.until(lambda: sight.error and sight.fault, "error in G1_ZSW and fault in ZSW2_ENC")
        _acknowledge_in_vain(rig)
    _check_reports(rig, case)
    assert rig.reason
    rig.end_fault()
    rig.until(lambda: sight.good, "IOPS GOOD")
    mark = next(number for number, text in enumerate(sight.shown) if not text.startswith(_POSITION))
    assert not any(text.startswith(_POSITION) for text in sight.shown[mark:]), sight.shown
    _check_latch(rig, case)


def _check_reports(rig: EncoderRig, case: Case) -> None:
    rig.cycles(QUIET_CYCLES)
    rig.check_reports(case)
    print(f"shown: {' > '.join(rig.sight.shown)}")
    assert any(text.startswith(_SHOWN[case.reaction]) for text in rig.sight.shown)


def _acknowledge_in_vain(rig: EncoderRig) -> None:
    """Acknowledge while the cause is still present: no effect."""
    rig.acknowledge()
    assert rig.sight.fault, "an acknowledge ended the fault although its cause is present"


def _check_latch(rig: EncoderRig, case: Case) -> None:
    """After its cause, the fault stays until the PLC acknowledges it."""
    rig.until(lambda: not rig.encoder.machine.faulty, "end of the cause")
    rig.cycles(QUIET_CYCLES)
    assert rig.sight.fault, "the fault ended by itself"
    assert case.reaction is Reaction.FAULT or rig.sight.error, "the error of the sensor ended by itself"
    rig.acknowledge()
    rig.until(lambda: rig.sight.measuring, "acknowledged")
    rig.until(lambda: not rig.encoder.fault_log.entries()[0].number, "P947 acknowledged")


@pytest.mark.parametrize("case", [case for case in ENCODER_CASES if case.device is Device.SENSOR], ids=str)
def test_drive_stays_in_operation_with_each_fault_of_its_encoder(case: Case) -> None:
    tables = axis(1, telegram_number=case.telegram, more=f"g1 = {ENCODER_NODE}") + _tables(case, 81)
    with running(configuration(tables)) as daemon:
        rig = SensorRig(daemon, case)
        sight = rig.sight
        rig.power_on(case)
        rig.enable()
        rig.move()
        rig.until(rig.moved, "moved")
        if case.reaction is Reaction.G1_ERROR:
            rig.until(lambda: sight.measuring, "position")
        mark = len(rig.states)
        del sight.shown[:-1]
        if case.reaction is Reaction.G1_ERROR:
            rig.start_fault(case.fault, case.values)
        rig.until(lambda: sight.error, "error in G1_ZSW")
        rig.cycles(QUIET_CYCLES)
        rig.check_reports(case)
        rig.end_fault(restart=case.reaction is Reaction.G1_MISSING)
        rig.until(lambda: rig.encoder.good and not rig.encoder.machine.faulty, "encoder back")
        rig.cycles(QUIET_CYCLES)
        if case.reaction is Reaction.G1_ERROR:
            assert sight.shown == [_POSITION, "G1 error 0001h"]
            rig.plc.set(0, {"G1_STW": _REQUEST | _SENSOR_ACKNOWLEDGE})
            rig.cycles(3)
            rig.plc.set(0, {"G1_STW": _REQUEST})
        rig.until(lambda: sight.measuring, "position again")
        assert not rig.states[mark:], "the drive left operation"
        assert rig.state is State.OPERATION_ENABLED
        assert "IOPS BAD" not in sight.shown
        assert not rig.axis.faults
        rig.off()
        rig.until(rig.standing, "OFF obeyed")


# -- gateways that would fail -----------------------------------------------------------------------------------------------


def _planted(fault: str, reaction: Reaction, numbers: tuple[int, ...] = (), **values: int) -> None:
    case = Case(fault, reaction, numbers, values=values, telegram=81, device=Device.ENCODER)
    test_gateway_reacts_to_each_fault_of_an_encoder(case)


@pytest.mark.planted
def test_gateway_that_shows_a_frozen_position_as_good_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    refresh = EncoderClient.refresh
    monkeypatch.setattr(EncoderClient, "refresh", lambda self, now: refresh(self, now) or self.generation > 0)
    with pytest.raises(AssertionError, match="ms old was shown as good"):
        _planted("lost-pdos", Reaction.LOSES, (101,), every=1)


@pytest.mark.planted
def test_gateway_that_forgets_a_fault_without_an_acknowledge_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    step = EncoderControl.step

    def forgetful(self: EncoderControl, word: int | None, *, fault: bool, warning: bool) -> int:
        self.fault = False
        return step(self, word, fault=fault, warning=warning)

    monkeypatch.setattr(EncoderControl, "step", forgetful)
    monkeypatch.setattr(encoder_machine, "_LATCHED", ())
    with pytest.raises(AssertionError, match="the fault ended by itself"):
        _planted("input-voltage", Reaction.FAULT, (10,))


def test_gateway_with_unexpected_reports_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rigs, "PATIENCE_S", 2)
    with pytest.raises(AssertionError, match="fault"):
        _planted("position-error", Reaction.MEASURES)
    with pytest.raises(AssertionError, match="warning not within"):
        _planted("duplicated-pdos", Reaction.WARNS)
