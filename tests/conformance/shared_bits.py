"""Cases for the bits that several motion telegrams share: power, speed, sensor, message word, sign of life.

The cases of a telegram run one after the other with the same gateway. Source: docs/telegrams.md, docs/motion.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

from pdgw.gateway.axis.telegrams import DSC_TELEGRAM_NUMBERS, POSITIONER_TELEGRAM_NUMBERS
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import telegram
from tests.conformance.telegram_bits import Case, Step, case_of, see

NUMBERS: Final = (4, 5, 6, 7, 102, 103, 105, 106, 110, 111)
_OFF: Step = {"set": {"STW1": 0x043E}}
"""OFF1 without another stop."""
_READY: Step = see(**{"ZSW1.READY_TO_SWITCH_ON": 1, "ZSW1.READY_TO_OPERATE": 0})
_ENABLE: tuple[Step, ...] = (_OFF, _READY, {"hold": "40 ms"}, {"enable": True})
_ERROR = 0x0F01


def _power(number: int) -> Iterator[Case]:
    running = see(
        ZSW1__OPERATION_ENABLED=1,
        ZSW1__SWITCHING_ON_INHIBITED=0,
        ZSW1__FAULT=0,
        ZSW1__NO_COAST_STOP=1,
        ZSW1__NO_QUICK_STOP=1,
        ZSW1__WARNING=0,
    )
    rows = (
        ("STW1.ON", "OFF1", {"STW1.ON": 0}, see(ZSW1__OPERATION_ENABLED=0, ZSW1__READY_TO_SWITCH_ON=1)),
        ("STW1.NO_COAST_STOP", "OFF2", {"STW1.NO_COAST_STOP": 0}, see(ZSW1__SWITCHING_ON_INHIBITED=1)),
        ("STW1.NO_QUICK_STOP", "OFF3", {"STW1.NO_QUICK_STOP": 0}, see(ZSW1__OPERATION_ENABLED=0)),
        (
            "STW1.ENABLE_OPERATION",
            "operation off, power stays",
            {"STW1.ENABLE_OPERATION": 0},
            see(ZSW1__OPERATION_ENABLED=0, ZSW1__READY_TO_OPERATE=1),
        ),
        (
            "STW1.CONTROL_BY_PLC",
            "control removed",
            {"STW1.CONTROL_BY_PLC": 0},
            see(ZSW1__OPERATION_ENABLED=0, ZSW1__CONTROL_REQUESTED=1),
        ),
    )
    for name, did, values, seen in rows:
        yield case_of(number, name, did, *_ENABLE, running, {"set": values}, seen)
    fault = see(ZSW1__FAULT=1, ZSW1__OPERATION_ENABLED=0)
    acknowledge = {"set": {"STW1.FAULT_ACKNOWLEDGE": 1}}
    steps = ({"drive": "fault 7"}, fault, {"drive": "clear"}, {"hold": "20 ms"}, _OFF, acknowledge, see(ZSW1__FAULT=0))
    yield case_of(number, "STW1.FAULT_ACKNOWLEDGE", "over-current, then its end", *_ENABLE, *steps)


def _speed(number: int) -> Iterator[Case]:
    full, rest = {"set": {"NSOLL_B": "750 rpm"}}, {"set": {"NSOLL_B": 0}}
    turning, standing = see(NIST_B="750 rpm +- 10 rpm"), see(NIST_B="0 +- 1 %")
    for name, did in (("ENABLE_RAMP_GENERATOR", "speed 0"), ("ENABLE_SETPOINT", "speed 0")):
        drop, restore = {"set": {f"STW1.{name}": 0}}, {"set": {f"STW1.{name}": 1}}
        yield case_of(number, f"STW1.{name}", did, *_ENABLE, full, turning, drop, standing, restore, turning, rest)
    hold = {"set": {"STW1.UNFREEZE_RAMP_GENERATOR": 0}}
    other = {"set": {"NSOLL_B": "300 rpm"}}
    held = (*_ENABLE, full, turning, hold, other, {"hold": "300 ms"}, turning, rest)
    yield case_of(number, "STW1.UNFREEZE_RAMP_GENERATOR", "the speed stays", *held)
    bits = ("ENABLE_RAMP_GENERATOR", "UNFREEZE_RAMP_GENERATOR", "ENABLE_SETPOINT")
    for which, too, jogged in ((1, 2, "-150 rpm"), (2, 1, "150 rpm")):
        jog = {"set": {f"STW1.JOG_{which}_ON": 1, **{f"STW1.{bit}": 0 for bit in bits}}}
        both = {"set": {f"STW1.JOG_{too}_ON": 1}}
        end = {"set": {"STW1.JOG_1_ON": 0, "STW1.JOG_2_ON": 0, **{f"STW1.{bit}": 1 for bit in bits}}}
        taken = (jog, see(NIST_B=f"{jogged} +- 10 rpm"), both, standing, end)
        yield case_of(number, f"STW1.JOG_{which}_ON", f"jog {which}, then both", *_ENABLE, rest, *taken)


def _message(number: int) -> Iterator[Case]:
    standing = {
        "RAMP_COMPLETED": 1,
        "TORQUE_BELOW_THRESHOLD": 1,
        "SPEED_BELOW_THRESHOLD_3": 1,
        "SPEED_BELOW_THRESHOLD_2": 1,
        "VARIABLE_MESSAGE": 0,
        "NO_MOTOR_OVERTEMPERATURE": 1,
        "NO_POWER_STAGE_OVERTEMPERATURE": 1,
        "SPEED_WITHIN_TOLERANCE": 1,
        "CONTROLLER_ENABLED": 1,
        "DRIVE_READY": 1,
        "PULSES_ENABLED": 1,
    }
    if number in POSITIONER_TELEGRAM_NUMBERS or number in DSC_TELEGRAM_NUMBERS:
        del standing["RAMP_COMPLETED"]  # Statusword.10 of a task or a cyclic mode
    for bit, value in standing.items():
        seen = see(**{f"MELDW.{bit}": value})
        steps = (seen,) if bit != next(iter(standing)) else (*_ENABLE, seen)
        yield case_of(number, f"MELDW.{bit}", "enabled, standing", *steps)
    gone = see(MELDW__CONTROLLER_ENABLED=0, MELDW__PULSES_ENABLED=0, MELDW__DRIVE_READY=1)
    yield case_of(number, "MELDW.PULSES_ENABLED = 0", "OFF1", _OFF, gone)


_UNPARKED: Step = {"hold": "150 ms"}
"""G1_ZSW.14 stays for at least 100 ms; nothing is activated meanwhile."""


def _sensor(number: int) -> Iterator[Case]:
    clear: Step = {"set": {"G1_STW": 0}}
    acknowledge: Step = {"set": {"G1_STW": 0x8000}}
    rows: tuple[tuple[str, str, Mapping[str, int], Step], ...] = (
        ("REQUEST_ABSOLUTE", "absolute value", {"REQUEST_ABSOLUTE": 1}, see(G1_ZSW__ABSOLUTE_VALID=1)),
        ("PARK", "parked", {"PARK": 1}, see(G1_ZSW__PARKED=1)),
        ("MODE", "probe 1, rising", {"FUNCTION_1": 1, "COMMAND": 1, "MODE": 1}, see(G1_ZSW__FUNCTION_1=1)),
        ("FUNCTION_2", "probe 1, falling", {"FUNCTION_2": 1, "COMMAND": 1, "MODE": 1}, see(G1_ZSW__FUNCTION_2=1)),
        ("FUNCTION_3", "probe 2, rising", {"FUNCTION_3": 1, "COMMAND": 1, "MODE": 1}, see(G1_ZSW__FUNCTION_3=1)),
        ("FUNCTION_4", "probe 2, falling", {"FUNCTION_4": 1, "COMMAND": 1, "MODE": 1}, see(G1_ZSW__FUNCTION_4=1)),
        ("FUNCTION_1", "reference mark", {"FUNCTION_1": 1, "COMMAND": 1, "MODE": 0}, see(G1_ZSW__FUNCTION_1=1)),
        ("COMMAND", "abort", {"FUNCTION_1": 1, "COMMAND": 3}, see(G1_ZSW__FUNCTION_1=0, G1_ZSW__ERROR=0)),
        (
            "COMMAND = 2",
            "no value to read",
            {"FUNCTION_4": 1, "COMMAND": 2, "MODE": 1},
            see(G1_ZSW__ERROR=1, G1_XIST2=7),
        ),
        ("PRESET", "not of a drive's position", {"PRESET": 1}, see(G1_ZSW__ERROR=1, G1_XIST2=_ERROR)),
    )
    for bit, did, bits, seen in rows:
        ask = {"set": {f"G1_STW.{name}": value for name, value in bits.items()}}
        yield case_of(number, f"G1_STW.{bit}", did, clear, _UNPARKED, ask, seen, acknowledge, {"hold": "40 ms"})
    for function in (1, 2, 3, 4):
        probe, rising = (function + 1) // 2, function % 2 == 1
        before, after = ("off", "on") if rising else ("on", "off")
        asked = {f"G1_STW.FUNCTION_{function}": 1, "G1_STW.MODE": 1}
        latched = (
            *(clear, {"hold": "40 ms"}, {"drive": f"probe {probe} {before}"}, {"hold": "40 ms"}),
            *({"set": {**asked, "G1_STW.COMMAND": 1}}, see(**{f"G1_ZSW__FUNCTION_{function}": 1}), {"hold": "200 ms"}),
            *({"drive": f"probe {probe} {after}"}, see(**{f"G1_ZSW__VALUE_{function}": 1, "G1_ZSW__ERROR": 0})),
            *({"set": {"G1_STW.COMMAND": 2}}, {"hold": "40 ms"}, clear, see(**{f"G1_ZSW__VALUE_{function}": 0})),
        )
        yield case_of(number, f"G1_ZSW.VALUE_{function}", f"probe {probe} {after}, read", *latched)
    failed = ({"set": {"G1_STW.PRESET": 1}}, see(G1_ZSW__ERROR=1))
    acknowledged = (acknowledge, see(G1_ZSW__ERROR_ACKNOWLEDGED=1), clear, see(G1_ZSW__ERROR=0))
    yield case_of(number, "G1_STW.ERROR_ACKNOWLEDGE", "error and its end", clear, *failed, *acknowledged)


def _second_sensor(number: int) -> Iterator[Case]:
    """Cases of the drive's second encoder: as G1, but without measuring probes."""
    clear: Step = {"set": {"G2_STW": 0}}
    acknowledge: Step = {"set": {"G2_STW": 0x8000}}
    nothing = {f"G2_ZSW.{bit.name}": 0 for bit in signal("G2_ZSW").bits if bit.name != "ERROR"}
    refused = see(**{"G2_ZSW.ERROR": 1, "G2_XIST2": _ERROR, **nothing})
    latch = {"COMMAND": 1, "MODE": 1}
    rows: tuple[tuple[str, str, Mapping[str, int], Step], ...] = (
        ("REQUEST_ABSOLUTE", "absolute value", {"REQUEST_ABSOLUTE": 1}, see(G2_ZSW__ABSOLUTE_VALID=1)),
        ("PARK", "parked", {"PARK": 1}, see(G2_ZSW__PARKED=1)),
        *((f"FUNCTION_{n}", "nothing latches it", {f"FUNCTION_{n}": 1, **latch}, refused) for n in (1, 2, 3, 4)),
        ("MODE", "no reference mark", {"FUNCTION_1": 1, "COMMAND": 1}, refused),
        ("COMMAND", "nothing to abort", {"FUNCTION_1": 1, "COMMAND": 3}, refused),
        ("PRESET", "not of a drive's position", {"PRESET": 1}, refused),
        ("PRESET_RELATIVE", "alone it does nothing", {"PRESET_RELATIVE": 1}, see(G2_ZSW=0)),
    )
    for bit, did, bits, seen in rows:
        ask = {"set": {f"G2_STW.{name}": value for name, value in bits.items()}}
        untouched = {"expect": {"G1_ZSW.ERROR": 0}}
        steps = (clear, {"hold": "40 ms"}, ask, seen, untouched, acknowledge, {"hold": "40 ms"})
        yield case_of(number, f"G2_STW.{bit}", did, *steps)
    acknowledged = (see(G2_ZSW__ERROR_ACKNOWLEDGED=1), clear, see(G2_ZSW__ERROR=0, G2_XIST2=0))
    failed = (clear, {"set": {"G2_STW.PRESET": 1}}, refused, acknowledge)
    yield case_of(number, "G2_STW.ERROR_ACKNOWLEDGE", "error and its end", *failed, *acknowledged)


def _not_evaluated(number: int) -> Iterator[Case]:
    ask: dict[str, int] = {"STW2.DATA_SET": 3, "STW2.PARK_AXIS": 1}
    seen: dict[str, int] = {"ZSW1.OPERATION_ENABLED": 1, "ZSW2.PARKED": 0, "ZSW2.PULSES_ENABLED": 0}
    if number not in POSITIONER_TELEGRAM_NUMBERS:
        ask["STW2.TO_FIXED_STOP"] = 1
        seen["ZSW2.TO_FIXED_STOP"] = 0
        ask |= {f"STW1.DEVICE_{place}": 1 for place in (11, 14, 15)}
    for name, value in ask.items():
        told = see(**seen)
        steps = (*_ENABLE, {"set": {name: value}}, {"hold": "40 ms"}, told, {"set": {name: 0}})
        yield case_of(number, name, "not evaluated", *steps)


def _cyclic(number: int) -> Iterator[Case]:
    turning = see(NIST_B="750 rpm +- 10 rpm", ZSW1__TARGET_REACHED=1)
    begin = (*_ENABLE, {"set": {"NSOLL_B": "750 rpm"}}, turning)
    frozen = see(NIST_B="750 rpm +- 10 rpm", ZSW1__TARGET_REACHED=0)
    held = ({"set": {"STW1.UNFREEZE_RAMP_GENERATOR": 0}}, {"set": {"NSOLL_B": "300 rpm"}}, {"hold": "100 ms"}, frozen)
    yield case_of(number, "STW1.UNFREEZE_RAMP_GENERATOR", "the speed stays", *begin, *held, {"set": {"NSOLL_B": 0}})
    for bit in ("ENABLE_RAMP_GENERATOR", "ENABLE_SETPOINT", "JOG_1_ON", "JOG_2_ON"):
        steps = ({"set": {f"STW1.{bit}": int(bit.startswith("JOG"))}}, {"hold": "100 ms"}, turning)
        yield case_of(number, f"STW1.{bit}", "not evaluated with DSC", *begin, *steps, {"set": {"NSOLL_B": 0}})


def _positioner(number: int) -> Iterator[Case]:
    yield case_of(
        number,
        "STW1.START_HOMING",
        "homing",
        *_ENABLE,
        {"home": {}},
        see(ZSW1__HOME_POSITION_SET=1, ZSW1__DRIVE_STOPPED=1, ZSW1__WITHIN_TOLERANCE=1),
        {"stop_homing": True},
        {"hold": "150 ms"},
    )
    stopped = see(ZSW1__DRIVE_STOPPED=1)
    for which in (1, 2):
        begin, moves = {"jog": which}, see(ZSW1__DRIVE_STOPPED=0)
        end = ({"jog": 0}, stopped, see(ZSW1__TARGET_REACHED=1))
        yield case_of(number, f"STW1.JOG_{which}_ON", f"jog {which}", *_ENABLE, begin, moves, *end)
    word = "POS_ZSW1" if number == 111 else "AKTSATZ"
    runs = see(**{f"{word}.BLOCK": 4, **({"POS_ZSW1.BLOCK_MODE": 1} if number == 111 else {})})
    goes_on = ({"next_block": True}, see(**{f"{word}.BLOCK": 5}), {"reject": True})
    speeds = ({"set": {"OVERRIDE": "100 %"}},) if number != 7 else ()
    steps = (*_ENABLE, *speeds, {"block": 4}, runs, {"hold": "400 ms"}, *goes_on, see(ZSW1__TARGET_REACHED=1))
    yield case_of(number, "STW1.EXTERNAL_BLOCK_CHANGE", "block 4, then on to 5", *steps)
    unknown = ({"set": {"SATZANW": 63, "STW1.ACTIVATE_TASK": 1}}, see(ZSW1__WARNING=1, ZSW1__TASK_ACKNOWLEDGE=0))
    if number != 111:
        rejected = ({"reject": True}, see(ZSW1__WARNING=0, AKTSATZ__BLOCK=0))
        yield case_of(number, "SATZANW.BLOCK", "a block that is not there, then reject", *_ENABLE, *unknown, *rejected)


def _target(number: int) -> Iterator[Case]:
    prefix = "POS_ZSW2" if number == 111 else "POS_ZSW"
    reached = f"{prefix}.SETPOINT_REACHED" if number == 111 else f"{prefix}.TARGET_REACHED"
    values = {"set": {"OVERRIDE": "100 %", "MDI_ACC": "100 %", "MDI_DEC": "100 %"}}

    def shown(**more: int) -> Step:
        return see(**{f"{prefix}.{name}": value for name, value in more.items()})

    forward = (shown(MOVES_FORWARD=1, SETPOINT_STATIONARY=0), see(ZSW1__TARGET_REACHED=1))
    end = see(**{reached: 1, f"{prefix}.SETPOINT_STATIONARY": 1})
    task = {"mdi": {"to": 20_000, "relative": True}}
    yield case_of(number, f"{prefix}.MOVES_FORWARD", "relative task forward", *_ENABLE, values, task, *forward, end)
    back = {"mdi": {"to": -20_000, "relative": True}}
    yield case_of(number, f"{prefix}.MOVES_BACKWARD", "and back", back, shown(MOVES_BACKWARD=1), end)
    fast = {"mdi": {"to": 5000, "relative": True, "velocity": 31_000}}
    yield case_of(number, f"{prefix}.SPEED_LIMITED", "faster than max_velocity", fast, shown(SPEED_LIMITED=1), end)
    far = {"mdi": {"to": 900_000, "velocity": 30_000}}
    stop = ({"intermediate_stop": True}, see(ZSW1__DRIVE_STOPPED=1, ZSW1__TARGET_REACHED=0), {"resume": True})
    reject = ({"reject": True}, see(ZSW1__DRIVE_STOPPED=1, ZSW1__TARGET_REACHED=1))
    yield case_of(number, "STW1.NO_INTERMEDIATE_STOP", "stop and continue", far, *stop, shown(MOVES_FORWARD=1), *reject)
    under_way = {"TRAVERSING": 1} if number == 111 else {}
    yield case_of(number, "STW1.DO_NOT_REJECT", "reject", far, shown(MOVES_FORWARD=1, **under_way), *reject)
    home: tuple[Step, ...] = (
        {"home": {}},
        see(ZSW1__HOME_POSITION_SET=1),
        {"stop_homing": True},
        {"hold": "150 ms"},
    )
    limits = {"set": {"POS_STW2.SOFTWARE_LIMITS": 1} if number == 111 else {"OVERRIDE": "100 %"}}
    for sign, bit in ((1, "PLUS"), (-1, "MINUS")):
        beyond = {"mdi": {"to": sign * 2_000_000, "velocity": 30_000}}
        at = {"expect": {f"{prefix}.SOFTWARE_LIMIT_{bit}": 1}, "within": "20 s"}
        yield case_of(number, f"{prefix}.SOFTWARE_LIMIT_{bit}", "target beyond it", *_ENABLE, *home, limits, beyond, at)
    if number == 110:
        follow = (
            {"set": {"POS_STW.TRACKING": 1}},
            shown(TRACKING=1),
            {"set": {"POS_STW.TRACKING": 0}},
            shown(TRACKING=0),
        )
        yield case_of(number, "POS_STW.TRACKING", "tracking", *_ENABLE, *follow)


def _life(number: int) -> Iterator[Case]:
    yield case_of(
        number, "STW2.SIGN_OF_LIFE", "first counter", {"set": {"STW2.SIGN_OF_LIFE": 5}}, see(ZSW2__SIGN_OF_LIFE="> 0")
    )


def walk(number: int) -> list[Case]:
    """All cases of a telegram, in order."""
    signals = {*telegram(number).setpoints.names, *telegram(number).actuals.names}
    cases = list(_power(number))
    if number in {4, 102, 103}:
        cases += _speed(number)
    elif number in DSC_TELEGRAM_NUMBERS:
        cases += _cyclic(number)
    else:
        cases += _positioner(number)
    for name, of_signal in _OF_SIGNALS:
        if name in signals:
            cases += of_signal(number)
    return cases


_OF_SIGNALS = (
    ("MDI_TARPOS", _target),
    ("G1_STW", _sensor),
    ("G2_STW", _second_sensor),
    ("STW2", _not_evaluated),
    ("MELDW", _message),
    ("STW2", _life),
)
"""The cases of a telegram with a signal, in the order of the tests."""
