"""Situations in which an axis does not move, over both links; and what every surface shows of them."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from pdgw.base.durations import MS
from pdgw.dsp402.states import STATUS_OF, State, StatusBit
from pdgw.gateway.base.reasons import Enable
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.objects.axis import Axis
from pdgw.gateway.service.status import snapshot
from pdgw.peers.drive import SimulatedDrive
from pdgw.peers.drive.model.model import DriveModel
from pdgw.peers.encoder import SimulatedEncoder
from pdgw.tools.output.status_text import Health, cause_sentence, check_line, object_lines, status_lines
from pdgw.tools.web.metrics import exposition
from pdgw.tools.web.mqtt import object_message
from pdgw.tools.web.status.watch import Watch
from tests.support.gateways import profinet_daemon
from tests.support.gateways.daemon import (
    OFF,
    ON,
    Plc,
    axis,
    configuration,
    drive_of,
    operating,
    running,
    switch_off,
    world_of,
)
from tests.support.page import ShownGateway, look

TRANSIENT_NS = 1500 * MS
"""By then every loss is found and every attempt to bring a node up again has failed once."""
SLOW_PLC = "cycle_time_ms = 20\nwatchdog_factor = 15"
"""The usual watchdog time with a fifth of the frames, because these tests last for seconds."""
_SLOW_PROFINET = "cycle_time_ms = 16\nwatchdog_factor = 12"
Step = Callable[[Plc, Daemon], None]


@dataclass(frozen=True, kw_only=True)
class Situation:
    """A situation, and how to get there from an axis in operation."""

    begin: Step = lambda _, __: None
    says: tuple[str, ...]
    """Words that the first line contains."""
    lacks: tuple[str, ...] = ()
    """Words that it does not contain."""
    health: Health = Health.CRITICAL
    cure: Step
    """Follow the remedy."""
    tables: str = axis(1)
    spoil: Callable[[Daemon], None] = lambda _: None
    """Before the gateway starts."""
    operates: bool = True
    """The axis is in operation before; otherwise it has never been."""
    numbers: tuple[int, ...] = ()
    """Telegrams that a PLC on UDP sends; empty: those of the gateway."""
    transport: str = SLOW_PLC
    host: str = "plc"


@contextmanager
def at_situation(situation: Situation, link: str = "udp") -> Iterator[tuple[Daemon, Plc]]:
    """A gateway and its PLC in this situation."""
    with _over_profinet(situation) if link == "profinet" else _over_udp(situation) as plc:
        if situation.operates:
            plc.enable()
        situation.begin(plc, plc.daemon)
        run_out(plc)
        yield plc.daemon, plc


def in_operation(tables: str = axis(1)) -> AbstractContextManager[tuple[Daemon, Plc]]:
    """A gateway, by default with one simulated axis, and its PLC; the first axis is in operation."""
    return operating(configuration(tables, transport=SLOW_PLC))


@contextmanager
def _over_udp(situation: Situation) -> Iterator[Plc]:
    with running(configuration(situation.tables, transport=situation.transport), situation.spoil) as daemon:
        yield Plc(daemon, list(situation.numbers) or [item.telegram.number for item in daemon.objects], situation.host)


@contextmanager
def _over_profinet(situation: Situation) -> Iterator[Plc]:
    with TemporaryDirectory() as folder:
        config = profinet_daemon.configuration(situation.tables, Path(folder) / "store.json", transport=_SLOW_PROFINET)
        with profinet_daemon.plant(config, before=situation.spoil, online=False) as site:
            site.plc.project = replace(site.plc.project, reduction_ratio=16, data_hold=25)
            yield profinet_daemon.ControllerPlc(site)


def both(*steps: Step) -> Step:
    """One step after the other."""

    def run(plc: Plc, daemon: Daemon) -> None:
        for step in steps:
            step(plc, daemon)

    return run


def send(*frames: dict[str, int]) -> Step:
    """The PLC sends these words for a time each."""

    def begin(plc: Plc, _: Daemon) -> None:
        for values in frames:
            plc.endpoint.set(0, values)
            run_out(plc, _FOR_A_TIME)

    return begin


def words(*frames: tuple[int, dict[str, int]]) -> Step:
    """The PLC sends STW1 and other words for a time each."""
    return send(*({"STW1": word} | others for word, others in frames))


def good(plc: Plc, _: Daemon) -> None:
    """The PLC sends what it should, and switches the axis on again."""
    plc.change, plc.silent, plc.endpoint.run = bytes, False, True
    plc.endpoint.bad.clear()
    plc.enable()


def acknowledge(plc: Plc, daemon: Daemon) -> None:
    """Remove the cause of the fault, acknowledge, then OFF and ON."""
    plc.silent = False
    drive_of(daemon).clear()
    words((OFF, {}), (OFF | 0x80, {}))(plc, daemon)
    plc.enable()


def online(plc: Plc, daemon: Daemon) -> None:
    """The device is on the bus again, and the PLC switches on."""
    plc.silent = False
    plc.until(lambda: all(item.good for item in daemon.objects), "online")
    plc.enable()


_FOR_A_TIME = 400 * MS
FAULTY = (State.FAULT, State.FAULT_REACTION_ACTIVE)


def show_no_supply(model: DriveModel, _: int) -> None:
    """The DC link is off: the drive stays without power whatever is commanded."""
    if model.state not in FAULTY:
        model.statusword = STATUS_OF[State.SWITCH_ON_DISABLED] | StatusBit.REMOTE
    model.statusword &= ~StatusBit.VOLTAGE_ENABLED


def show_not_enabled(model: DriveModel, _: int) -> None:
    """Safe torque off: the drive stays below operation, with its supply."""
    if model.state not in FAULTY and model.statusword & StatusBit.VOLTAGE_ENABLED:
        enabled = StatusBit.VOLTAGE_ENABLED | StatusBit.NO_QUICK_STOP | StatusBit.REMOTE
        model.statusword = STATUS_OF[State.READY_TO_SWITCH_ON] | enabled


def clear_bits(plc: Plc, mask: int) -> None:
    """The PLC's program takes bits of STW1 away."""
    plc.endpoint.set(0, {"STW1": plc.endpoint.setpoints[0]["STW1"] & ~mask})


def run_out(plc: Plc, ns: int = TRANSIENT_NS) -> None:
    """Exchange for this time."""
    end = plc.loop.now() + ns
    while plc.loop.now() < end:
        plc.exchange()


def _take_enables(plc: Plc, daemon: Daemon) -> None:
    """The drive's own enables go, and the PLC tries again."""
    drive_of(daemon).model.disguises.append(show_not_enabled)
    run_out(plc)
    plc.endpoint.set(0, {"STW1": OFF})
    run_out(plc)
    plc.endpoint.set(0, {"STW1": ON})


def _first(daemon: Daemon) -> SimulatedDrive | SimulatedEncoder:
    """The device of the first drive object."""
    device = world_of(daemon).simulations["can"].device(daemon.objects[0].node_id)
    assert isinstance(device, SimulatedDrive | SimulatedEncoder)
    return device


def _silence(plc: Plc, _: Daemon) -> None:
    plc.silent = True


BREAKERS: dict[Enable, Step] = {
    Enable.BUS: lambda _, daemon: world_of(daemon).unplug("world"),
    Enable.NODE: lambda _, daemon: switch_off(daemon, _first(daemon)),
    Enable.SUPPLY: lambda _, daemon: drive_of(daemon).model.disguises.insert(0, show_no_supply),
    Enable.NO_FAULT: lambda _, daemon: _first(daemon).inject(
        7 if isinstance(daemon.objects[0], Axis) else "position-error"
    ),
    Enable.OPERATION: _take_enables,
    Enable.PLC: _silence,
    Enable.CONTROL: lambda plc, _: clear_bits(plc, 0x400),
    Enable.ON_EDGE: lambda plc, _: clear_bits(plc, 0x1),
    Enable.SETPOINT: lambda plc, _: clear_bits(plc, 0x10),
}
"""What breaks each link of an axis in operation."""


@dataclass(frozen=True)
class Shown:
    """What the surfaces show of the first drive object, and the sentence of its document."""

    sentence: str
    surfaces: dict[str, str]


def shown(daemon: Daemon) -> Shown:
    """Read every surface."""
    gateway = ShownGateway()
    gateway.show(daemon)
    watch = Watch(daemon.config, gateway)
    look(watch)
    document = snapshot(daemon)
    item = (*document["axes"], *document["encoders"])[0]
    event = [event.text for event in watch.log.after(0) if event.kind == "reason" and event.do_id == item["do_id"]][-1]
    text = " ".join(object_lines(document, item["do_id"], 400))
    if document["causes"]:
        assert cause_sentence(document["causes"][0]).endswith(item["sentence"].partition(": ")[2])
        assert cause_sentence(document["causes"][0]) in " ".join(status_lines(document, 400))
    message = json.loads(object_message(item))
    return Shown(
        item["sentence"],
        {
            "--check": check_line(document)[1],
            "status": text,
            "event": event,
            "MQTT": message["sentence"],
            "metrics": exposition(watch)().decode(),
        },
    )


def _power_off(*nodes: int) -> Step:
    def step(_: Plc, daemon: Daemon) -> None:
        for node in nodes:
            switch_off(daemon, drive_of(daemon, node))

    return step


def _power_on(*nodes: int) -> Step:
    def step(plc: Plc, daemon: Daemon) -> None:
        for node in nodes:
            drive_of(daemon, node).node.restart()
        online(plc, daemon)

    return step


def _idle(plc: Plc, _: Daemon) -> None:
    """The PLC's program asks for nothing and has no control."""
    plc.endpoint.set(0, {"STW1": 0})


def _fault_then_silence(plc: Plc, daemon: Daemon) -> None:
    drive_of(daemon).inject(7)
    run_out(plc)
    plc.silent = True


def _on_too_early(plc: Plc, _: Daemon) -> None:
    """After a loss of the PLC, the first frame has ON."""
    plc.silent = True
    run_out(plc)
    plc.silent = False


def _stop(plc: Plc, _: Daemon) -> None:
    plc.endpoint.run = False


def trip(plc: Plc, daemon: Daemon) -> None:
    """The drive is in fault, and its cause is gone."""
    model = drive_of(daemon).model
    drive_of(daemon).inject(7)
    plc.until(lambda: model.state is State.FAULT, "the fault")
    model.clear()


def supply(_: Plc, daemon: Daemon) -> None:
    """The power stage has its supply again."""
    drive_of(daemon).model.disguises.clear()


_OFF_BUS = ("Not on the bus: node 1 on bus can: ", "Check power, CAN cable, termination")
_FAULT = ("Fault: EMCY 2310h over-current, since ", "short circuit", "then acknowledge (STW1.7)")
SITUATIONS: dict[str, Situation] = {
    "the CAN adapter is unplugged": Situation(
        begin=BREAKERS[Enable.BUS],
        says=("Not on the bus: bus can: its interface is lost", "check the CAN interface"),
        lacks=("node 1",),
        cure=both(lambda _, daemon: world_of(daemon).unplug("world", False), online),
    ),
    "the drive has no power, and the PLC is silent too": Situation(
        begin=both(BREAKERS[Enable.NODE], _silence), says=_OFF_BUS, lacks=("PLC",), cure=_power_on(1)
    ),
    "the drive has no power, and the PLC idles": Situation(
        begin=both(BREAKERS[Enable.NODE], _idle), says=_OFF_BUS, lacks=("PLC", "STW1"), cure=_power_on(1)
    ),
    "three drives lose their power at one moment": Situation(
        begin=_power_off(1, 2, 3),
        says=(
            "axes 1-3 Not on the bus: 3 of 3 nodes on bus can lost within ",
            "CAN cable or supply",
            "these nodes share",
        ),
        lacks=("no TPDO", "node-ID"),
        cure=_power_on(1, 2, 3),
        tables=axis(1) + axis(2) + axis(3),
    ),
    "the CAN cable is broken in front of two of three drives": Situation(
        begin=_power_off(1, 2),
        says=(
            "axes 1-2 Not on the bus: 2 of 3 nodes on bus can lost within ",
            "CAN cable or supply",
            "these nodes share",
        ),
        lacks=("no TPDO", "node-ID"),
        cure=_power_on(1, 2),
        tables=axis(1) + axis(2) + axis(3),
    ),
    "the emergency stop has cut the supply of the power stage": Situation(
        begin=BREAKERS[Enable.SUPPLY],
        says=("Waits", "no supply voltage (Statusword.4 = 0)", "main contactor, emergency stop"),
        lacks=("STW1",),
        health=Health.WARNING,
        cure=both(supply, good),
    ),
    "the drive reports a fault": Situation(
        begin=BREAKERS[Enable.NO_FAULT], says=_FAULT, lacks=("needs an edge", "cause is still there"), cure=acknowledge
    ),
    "the drive reports a fault, then the PLC stops": Situation(
        begin=_fault_then_silence, says=_FAULT, lacks=("PLC lost",), cure=acknowledge
    ),
    "safe torque off: the drive does not follow ON": Situation(
        begin=BREAKERS[Enable.OPERATION],
        says=("Starting: ON is commanded, but the drive reports Ready to Switch On", "safe torque off (STO)"),
        health=Health.WARNING,
        cure=both(supply, good),
    ),
    "the PLC's cable is off": Situation(
        begin=BREAKERS[Enable.PLC],
        says=("Waits: PLC lost: ", "check the cable, the PLC's operating mode (STOP)"),
        lacks=("node 1", "no valid frame from the PLC yet"),
        cure=good,
    ),
    "the PLC's program does not take control": Situation(
        begin=BREAKERS[Enable.CONTROL],
        says=("Waits: STW1.10 = 0 (control by PLC)", "must set STW1.10 = 1"),
        health=Health.WARNING,
        cure=good,
    ),
    "the PLC comes back with ON in its first frame": Situation(
        begin=_on_too_early,
        says=("Waits: ON ignored: PLC lost: no valid frame", "Check the cable", "; then OFF and ON"),
        lacks=("send an OFF first",),
        health=Health.WARNING,
        cure=words((OFF, {}), (ON, {})),
    ),
    "the PLC's program enables no operation": Situation(
        begin=lambda plc, _: clear_bits(plc, 0x8),
        says=("Waits: the PLC does not enable operation: STW1.3 = 0", "must set STW1.3 = 1"),
        health=Health.WARNING,
        cure=words((ON, {})),
    ),
    "an interlock in the PLC holds OFF2": Situation(
        begin=lambda plc, _: clear_bits(plc, 0x2),
        says=(
            "Waits",
            "sends ON (STW1.0 = 1) and keeps the drive off: STW1.1 = 0",
            "must set STW1.1 = 1; then OFF and ON",
        ),
        lacks=("coast stop",),
        health=Health.WARNING,
        cure=good,
    ),
    "an interlock in the PLC holds OFF3, and enables no operation": Situation(
        begin=lambda plc, _: clear_bits(plc, 0xC),
        says=("Waits", "keeps the drive off: STW1.2 = STW1.3 = 0", "must set STW1.2 = STW1.3 = 1; then OFF and ON"),
        lacks=("quick stop in progress",),
        health=Health.WARNING,
        cure=good,
    ),
    "the PLC's program enables no setpoint": Situation(
        begin=BREAKERS[Enable.SETPOINT],
        says=("Waits: no setpoint: STW1.4 = 0", "must set STW1.4 = 1"),
        lacks=("STW1.5", "STW1.6"),
        health=Health.WARNING,
        cure=words((ON, {})),
    ),
    "the PLC is in STOP": Situation(
        begin=_stop,
        says=("the PLC is in STOP", "set the PLC to RUN"),
        lacks=("check the cable", "bring the PLC to RUN", "no valid frame from the PLC yet"),
        health=Health.WARNING,
        cure=good,
    ),
    "the PLC marks the data of the axis as bad": Situation(
        begin=lambda plc, _: plc.endpoint.bad.add(0),
        says=("IOPS", "80h"),
        lacks=("check the cable", "bring the PLC to RUN", "no valid frame from the PLC yet"),
        health=Health.WARNING,
        cure=good,
    ),
    "the PLC acknowledges without control": Situation(
        begin=both(trip, words((0x007E, {}), (0x00FE, {}))),
        says=("EMCY", "STW1.7 has no effect while STW1.10 = 0"),
        cure=acknowledge,
    ),
    "the PLC holds the acknowledge": Situation(
        begin=both(words((OFF | 0x80, {})), trip),
        says=("EMCY", "needs an edge", "STW1.7 to 0 and then to 1"),
        cure=acknowledge,
    ),
    "the PLC acknowledges while the cause is there": Situation(
        begin=both(BREAKERS[Enable.NO_FAULT], words((OFF, {}), (OFF | 0x80, {}))),
        says=("EMCY", "the cause is still there", "STW1.7 to 0 and then to 1"),
        cure=acknowledge,
    ),
}
"""What a technician finds, over both links."""
