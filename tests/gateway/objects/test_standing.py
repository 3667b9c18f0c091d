"""The first line of each situation is true later, and after a restart of the gateway, over both links."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from pdgw.base.durations import SECOND
from pdgw.ds301.aborts import CanopenError
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.service.status import snapshot
from pdgw.tools.output.status_text import cause_sentence
from tests.conformance.rig import COMPLETE
from tests.gateway.objects.test_happenings import IN_SUITE, judge
from tests.support.documents.night_situations import NIGHT_SITUATIONS
from tests.support.documents.situation_table import BY_LINK
from tests.support.documents.situations import SLOW_PLC, at_situation, run_out
from tests.support.gateways.daemon import Plc, axis, configuration, drive_of, running
from tests.support.gateways.restart import COMMANDED, KILLED, restarted

_LATER_NS = {"udp": (3600 if COMPLETE else 20) * SECOND, "profinet": 20 * SECOND}
"""A controller takes more time for an hour than a PLC on UDP."""
_SLOWER = {SLOW_PLC: "cycle_time_ms = 100\nwatchdog_factor = 3"}
"""The same watchdog time, with a fifth of the cycles."""
_END = {
    "safe torque off: the drive does not follow ON",
    "the drive waits in Switched On until its brake is open",
    "the drive waits at standstill until its brake is closed",
    "telegram 111: an absolute task after the drive has lost its home position",
}
"""Situations that end by themselves, or become another one (ON is used up)."""
_STARTED_NS = 5 * SECOND
"""By then the next gateway knows each device, or has missed it."""
_IGNORED = "Waits: ON ignored: the gateway has started, since "
_SILENT = ("Not on the bus: node ", "no answer from node ", "check power, CAN cable")
_NO_PLC = ("Waits: no valid frame from the PLC yet", "bring the PLC to RUN")
_OLDER = ("Fault: over-current (older than the connection); before: EMCY 2310h over-current, since ", "short circuit")
_OVER = ("In operation",)
_OFF = ("Off: the PLC has switched the drive off",)
_AFTER_A_RESTART: dict[str, tuple[str, ...]] = {
    "three drives lose their power at one moment": ("3 of 3 nodes on bus can have not answered since the start",),
    "the CAN cable is broken in front of two of three drives": ("2 of 3 nodes on bus can have not answered since",),
    "the drive reports a fault": _OLDER,
    "the drive reports a fault, then the PLC stops": _OLDER,
    "the PLC acknowledges while the cause is there": (*_OLDER, "needs an edge"),
    "the drive sends its EMCY with another COB-ID (1014h)": _OLDER,
    "the drive sends an EMCY of three bytes": _OLDER,
    "the drive sends heartbeats of two bytes, and has a fault": _OLDER,
    "the PLC's cable is off": _NO_PLC,
    "another sender's frames come, then the PLC is silent": _NO_PLC,
    "the supply of the power stage is cut, then the PLC is silent": _NO_PLC,
    "the drive has another node-ID than the configuration": _SILENT,
    "a technician sets another node-ID while the drive is lost": _SILENT,
    "the encoder has no power": _SILENT,
    "the drive restarts, and then answers no SDO request": _SILENT,
    "the encoder had no power for a moment, twice": _OVER,
    "the encoder had no power, and the PLC acknowledges its fault alone": _OVER,
    "the PLC acknowledges an encoder and does not end it": _OVER,
    "the PLC acknowledges the sensor of an encoder, and not its fault": _OVER,
    "the PLC acknowledges an encoder while the cause is there": ("Fault: sensor error 0001h", "remove the cause"),
    "the PLC acknowledges the fault of an encoder while the cause is there": ("Fault: the encoder is in fault",),
    'STW1.10 falls in operation, with control_lost = "hold"': ("Waits: STW1.10 = 0", "must set STW1.10 = 1"),
    "the drive waits at standstill until its brake is closed": _OFF,
    "the drive enables itself during OFF": _OFF,
    "the drive ignores OFF3, and the gateway stops its node": ("keeps the drive off: STW1.2 = 0 (OFF3)",),
    "all PDOs of the drive end in operation, and its heartbeats arrive": (
        "none of TPDO1, TPDO2",
        "check the TPDOs of the device, and who writes its communication objects",
    ),
    "a short circuit of the bus, and the interface does not restart": (
        "bus can: the interface sends no frame and reports no error",
        "if it is bus-off since before the start",
    ),
    "the CAN adapter takes frames and sends none when ON comes": (
        "its frames arrive, and it answers no SDO request",
        "unplug the CAN adapter",
    ),
    "after a short circuit of the bus the heartbeat consumer of the drive stays in error": (
        "Fault: CANopen (older than the connection); before: CAN bus lost",
    ),
}
"""Words of the first line where it is neither that of before nor that of an ignored ON. What is over is not named."""
_NO_CONTROLLER = ("Waits: no controller has connected to the name of station press-1", "the controller is on", "cable")
_OVER_PROFINET = {title: _NO_CONTROLLER if words is _NO_PLC else words for title, words in _AFTER_A_RESTART.items()} | {
    "another controller is rejected, then the controller is silent": _NO_CONTROLLER,
    "the controller's project was rejected once before, then the controller is silent": _NO_CONTROLLER,
    "the controller ends the relationship with an error": _NO_CONTROLLER,
}
"""The same over PROFINET: a controller that is silent has no relationship with the next gateway."""
_READINGS = {"udp": _AFTER_A_RESTART, "profinet": _OVER_PROFINET}
_CONNECTS_AGAIN = "the controller does not receive the calls of the device"
"""To the next gateway too: its line has the time of that."""
_STARTS_NOT = "the CAN adapter is unplugged"
_TIME = re.compile(r"\d\d:\d\d:\d\d")
_TIME_LENGTH = len("22:13:20")


def line_of(daemon: Daemon) -> str:
    """The first line: of the first cause, else of the first drive object."""
    document = snapshot(daemon)
    item = (*document["axes"], *document["encoders"])[0]
    return cause_sentence(document["causes"][0]) if document["causes"] else str(item["sentence"])


@pytest.mark.parametrize(
    ("link", "title"),
    [(link, title) for link, found in (BY_LINK if COMPLETE else IN_SUITE).items() for title in sorted(found)],
)
def test_first_line_is_true_later_and_after_a_restart(link: str, title: str) -> None:
    """The next gateway names again what is still there. For what happened before, it shows the time at which that happened."""
    situation, words = BY_LINK[link][title], _READINGS[link].get(title)
    situation = replace(situation, transport=_SLOWER.get(situation.transport, situation.transport))
    with at_situation(situation, link) as (daemon, plc):
        before = line_of(daemon)
        if title not in _END:
            run_out(plc, _LATER_NS[link])
            judge(situation, daemon)
        if title == _STARTS_NOT:
            with pytest.raises(CanopenError, match="one that is plugged in"), restarted(plc, daemon):
                pass
            return
        with restarted(plc, daemon) as following:
            kept = [item.origins.last(following.loop) for item in following.objects]
            run_out(plc, _STARTED_NS)
            line = line_of(following)
            if words is not None:
                assert [text for text in words if text.lower() not in line.lower()] == [], line
            elif _IGNORED in line:
                assert COMMANDED in line
                assert all(text in line for text in kept), line
            else:
                judge(situation, following)
            if title == _CONNECTS_AGAIN:
                return
            times = _TIME.findall(line.partition(_IGNORED)[2][_TIME_LENGTH:] or line)
            assert set(times) <= {*_TIME.findall(" ".join((before, COMMANDED, *kept)))}, "nothing else has begun"


@pytest.mark.parametrize("kept", ["", "CAN bus lost, since 04:11:02"])
def test_heartbeat_error_of_before_the_start_is_explained_unless_its_cause_was_kept(kept: str) -> None:
    def before(daemon: Daemon) -> None:
        drive_of(daemon).inject("CANopen")
        daemon.recall(KILLED, {"1": kept})

    with running(configuration(axis(1), transport=SLOW_PLC), before) as daemon:
        Plc(daemon, [1]).until(lambda: daemon.axes[0].faults, "the fault")
        cause = f"; before: {kept}" if kept else ": the gateway sent no heartbeat before its start"
        assert daemon.axes[0].enable_status.text == f"Fault: CANopen (older than the connection){cause}"


def test_device_whose_frames_arrive_has_power_and_cable_although_it_does_not_answer() -> None:
    """After a restart beside an adapter that sends nothing: the device still has the heartbeat time of the last gateway."""
    situation = NIGHT_SITUATIONS["the CAN adapter takes frames and sends none when ON comes"]
    with at_situation(situation) as (daemon, plc), restarted(plc, daemon) as following:
        run_out(plc, _STARTED_NS)
        text = following.axes[0].enable_status.text
        assert (
            "node 1 on bus can: its frames arrive, and it answers no SDO request: the interface may send nothing"
            in text
        )
        assert "Check power" not in following.axes[0].enable_status.sentence
