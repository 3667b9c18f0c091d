"""Situations in which an axis does not move, each made in a daemon's world; and what every surface shows of it."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass

from pdgw.dsp402.states import STATUS_OF, State, StatusBit
from pdgw.durations import MS
from pdgw.gateway.daemon import Daemon
from pdgw.gateway.reasons import Enable
from pdgw.gateway.service.status import snapshot
from pdgw.peers.drive.model.model import DriveModel
from pdgw.tools.output.status_check import check_line
from pdgw.tools.output.status_text import cause_sentence, object_lines, status_lines
from pdgw.web.metrics import exposition
from pdgw.web.mqtt import object_message
from pdgw.web.status.watch import Watch
from tests.support.gateways.daemon import OFF, ON, Plc, drive_of, world_of
from tests.support.page import ShownGateway, look

SETTLED = 1500 * MS
"""By then every loss is found and every attempt to bring a node up again has failed once."""


FAULTY = (State.FAULT, State.FAULT_REACTION_ACTIVE)


def show_no_supply(model: DriveModel, _: int) -> None:
    """The DC link is off: the drive stays without power whatever is commanded."""
    if model.state not in FAULTY:
        model.statusword = STATUS_OF[State.SWITCH_ON_DISABLED]
    model.statusword &= ~StatusBit.VOLTAGE_ENABLED


def show_not_enabled(model: DriveModel, _: int) -> None:
    """Safe torque off: the drive stays below operation, with its supply."""
    if model.state not in FAULTY and model.statusword & StatusBit.VOLTAGE_ENABLED:
        model.statusword = STATUS_OF[State.READY_TO_SWITCH_ON] | StatusBit.VOLTAGE_ENABLED | StatusBit.NO_QUICK_STOP


def clear_bits(plc: Plc, mask: int) -> None:
    """The PLC's program takes bits of STW1 away."""
    plc.endpoint.set(0, {"STW1": plc.endpoint.setpoints[0]["STW1"] & ~mask})


def settle(plc: Plc) -> None:
    """Exchange until every loss is found and every attempt to bring a node up again has failed once."""
    end = plc.loop.now() + SETTLED
    while plc.loop.now() < end:
        plc.exchange()


def _take_enables(plc: Plc, daemon: Daemon) -> None:
    """The drive's own enables go, and the PLC tries again."""
    drive_of(daemon).model.disguises.append(show_not_enabled)
    settle(plc)
    plc.endpoint.set(0, {"STW1": OFF})
    settle(plc)
    plc.endpoint.set(0, {"STW1": ON})


def _silence(plc: Plc, _: Daemon) -> None:
    plc.silent = True


BREAKERS: dict[Enable, Callable[[Plc, Daemon], None]] = {
    Enable.BUS: lambda _, daemon: world_of(daemon).unplug("world"),
    Enable.NODE: lambda _, daemon: drive_of(daemon).node.power_off(),
    Enable.SUPPLY: lambda _, daemon: drive_of(daemon).model.disguises.insert(0, show_no_supply),
    Enable.NO_FAULT: lambda _, daemon: drive_of(daemon).inject(7),
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
    (event,) = [event.text for event in watch.log.after(0) if event.kind == "reason" and event.do_id == item["do_id"]]
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


def _idle(plc: Plc, _: Daemon) -> None:
    """The PLC's program asks for nothing and has no control."""
    plc.endpoint.set(0, {"STW1": 0})


def _fault_then_silence(plc: Plc, daemon: Daemon) -> None:
    drive_of(daemon).inject(7)
    settle(plc)
    plc.silent = True


def _on_too_early(plc: Plc, _: Daemon) -> None:
    """After a loss of the PLC, the first frame has ON."""
    plc.silent = True
    settle(plc)
    plc.silent = False


def _both(*steps: Callable[[Plc, Daemon], None]) -> Callable[[Plc, Daemon], None]:
    def run(plc: Plc, daemon: Daemon) -> None:
        for step in steps:
            step(plc, daemon)

    return run


SITUATIONS: dict[str, Callable[[Plc, Daemon], None]] = {
    "the CAN adapter is unplugged": BREAKERS[Enable.BUS],
    "the drive has no power, and the PLC is silent too": _both(BREAKERS[Enable.NODE], _silence),
    "the drive has no power, and the PLC idles": _both(BREAKERS[Enable.NODE], _idle),
    "the emergency stop has cut the supply of the power stage": BREAKERS[Enable.SUPPLY],
    "the drive reports a fault": BREAKERS[Enable.NO_FAULT],
    "the drive reports a fault, then the PLC stops": _fault_then_silence,
    "safe torque off: the drive does not follow ON": BREAKERS[Enable.OPERATION],
    "the PLC's cable is off": BREAKERS[Enable.PLC],
    "the PLC's program does not take control": BREAKERS[Enable.CONTROL],
    "the PLC comes back with ON in its first frame": _on_too_early,
    "the PLC's program enables no operation": lambda plc, _: clear_bits(plc, 0x8),
    "an interlock in the PLC holds OFF2": lambda plc, _: clear_bits(plc, 0x2),
    "an interlock in the PLC holds OFF3, and enables no operation": lambda plc, _: clear_bits(plc, 0xC),
    "the PLC's program enables no setpoint": BREAKERS[Enable.SETPOINT],
}
"""What a technician finds, and how to get there from an axis in operation."""
