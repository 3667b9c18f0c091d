"""Situations in which the PLC's frames or words are the cause; each with its words, its exit status and its cure."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from pdgw.dsp402.states import State
from pdgw.gateway.daemon import Daemon
from pdgw.gateway.links.profinet.identity import profinet_model
from pdgw.peers.controller.controller import Phase
from pdgw.peers.controller.project import Project
from pdgw.profidrive.frame import STATUS_DATA_VALID, STATUS_NORMAL, STATUS_RUN, TRAILER
from pdgw.profidrive.telegrams import telegram
from pdgw.tools.output.status_check import Health
from tests.support.documents.situations import SETTLED, settle
from tests.support.gateways import profinet_daemon
from tests.support.gateways.daemon import OFF, Plc, axis, configuration, drive_of, running
from tests.support.gateways.profinet_daemon import Plant, plant

Step = Callable[[Plc, Daemon], None]
_SHORT = "cycle_time_ms = 4\nwatchdog_factor = 3"
_ROUTED = 'cycle_time_ms = 4\nwatchdog_factor = 75\nlisten = "192.168.0.5"\npeer = "192.168.0.10"'


@dataclass(frozen=True, kw_only=True)
class PlcSituation:
    """A situation, and how to get there from an axis in operation, or, with ``numbers``, from the start."""

    begin: Step = lambda _, __: None
    says: tuple[str, ...]
    """Words that the first line contains."""
    lacks: tuple[str, ...] = ("check the cable", "bring the PLC to RUN", "no valid frame from the PLC yet")
    """Words that it does not contain."""
    health: Health = Health.CRITICAL
    cure: Step
    """Follow the remedy."""
    numbers: tuple[int, ...] = ()
    """Telegrams that the PLC sends; empty: that of the axis."""
    transport: str = ""
    host: str = "plc"


def changes(change: Callable[[bytearray], bytes]) -> Step:
    """The PLC sends frames that are changed in this way."""

    def begin(plc: Plc, _: Daemon) -> None:
        plc.change = change

    return begin


def good(plc: Plc, _: Daemon) -> None:
    """The PLC sends what it should, and switches the axis on again."""
    plc.change, plc.silent, plc.endpoint.run = bytes, False, True
    plc.endpoint.bad.clear()
    plc.enable()


def right_layout(plc: Plc, daemon: Daemon) -> None:
    """The program of the PLC has the telegrams of the configuration."""
    Plc.__init__(plc, daemon, [item.telegram.number for item in daemon.objects])
    plc.enable()


def _with_status(status: int) -> Step:
    return changes(lambda frame: bytes(frame[:-2]) + bytes((status, 0)))


def _same_counter(frame: bytearray) -> bytes:
    return bytes(frame[: -TRAILER.size]) + bytes(2) + bytes(frame[-2:])


def _without_tick(frame: bytearray) -> bytes:
    place = len(frame) - TRAILER.size
    return bytes(frame[: place - 4]) + bytes(4) + bytes(frame[place:])


def _of_another_frame_id(frame: bytearray) -> bytes:
    return b"\xc0\x02" + bytes(frame[2:])


def _stop(plc: Plc, _: Daemon) -> None:
    plc.endpoint.run = False


def _mark_bad(plc: Plc, _: Daemon) -> None:
    plc.endpoint.bad.add(0)


def _every_fifth_cycle(plc: Plc, _: Daemon) -> None:
    """The task of the PLC has a cycle of 20 ms."""
    calls = 0
    send = plc.send

    def seldom() -> None:
        nonlocal calls
        calls += 1
        if calls % 5 == 0:
            send()

    plc.send = seldom  # type: ignore[method-assign]


def _in_each_cycle(plc: Plc, daemon: Daemon) -> None:
    del plc.send  # type: ignore[method-assign]
    good(plc, daemon)


def _use_another_byte_after_the_last_object(plc: Plc, _: Daemon) -> None:
    plc.endpoint.set(len(plc.endpoint.setpoints) - 1, {"STW1": OFF})


def _trip(plc: Plc, daemon: Daemon) -> None:
    """The drive is in fault, and its cause is gone."""
    model = drive_of(daemon).model
    drive_of(daemon).inject(7)
    plc.until(lambda: model.state is State.FAULT, "the fault")
    model.clear()


def _acknowledge_without_control(plc: Plc, daemon: Daemon) -> None:
    _trip(plc, daemon)
    for word in (0x007E, 0x00FE):
        plc.endpoint.set(0, {"STW1": word})
        for _ in range(50):
            plc.exchange()


def _hold_the_acknowledge(plc: Plc, daemon: Daemon) -> None:
    """The program has set STW1.7 before the fault."""
    plc.endpoint.set(0, {"STW1": OFF | 0x80})
    for _ in range(50):
        plc.exchange()
    _trip(plc, daemon)


def _acknowledge_while_the_cause_is_there(plc: Plc, daemon: Daemon) -> None:
    drive_of(daemon).inject(7)
    for word in (OFF, OFF | 0x80):
        plc.endpoint.set(0, {"STW1": word})
        for _ in range(50):
            plc.exchange()


def _acknowledge(plc: Plc, daemon: Daemon) -> None:
    drive_of(daemon).model.clear()
    for word in (OFF, OFF | 0x80):
        plc.endpoint.set(0, {"STW1": word})
        for _ in range(50):
            plc.exchange()
    plc.enable()


@contextmanager
def at_plc_situation(situation: PlcSituation) -> Iterator[tuple[Daemon, Plc]]:
    """A gateway and its PLC in this situation."""
    with running(configuration(axis(1), transport=situation.transport)) as daemon:
        plc = Plc(daemon, list(situation.numbers or (1,)), situation.host)
        if not situation.numbers:
            plc.enable()
        situation.begin(plc, daemon)
        settle(plc)
        yield daemon, plc


PLC_SITUATIONS: dict[str, PlcSituation] = {
    "the PLC sends a longer telegram": PlcSituation(
        numbers=(111,),
        says=("frames of", "expected: 46 bytes for telegrams 1", "pdgw map"),
        cure=right_layout,
    ),
    "the PLC sends another telegram of the same length": PlcSituation(
        numbers=(102,),
        begin=lambda plc, _: plc.endpoint.set(0, {"STW1": OFF, "MOMRED": 1}),
        says=("byte 11 is not 0", "expected: 46 bytes for telegrams 1", "pdgw map"),
        cure=right_layout,
    ),
    "the PLC sends one axis too many": PlcSituation(
        numbers=(1, 1),
        begin=_use_another_byte_after_the_last_object,
        says=("byte 8 is not 0", "the last object ends before it", "pdgw map"),
        cure=right_layout,
    ),
    "the PLC sends another FrameID": PlcSituation(
        begin=changes(_of_another_frame_id), says=("FrameID C002h, expected C001h",), cure=good
    ),
    "the PLC marks its frames as not valid": PlcSituation(
        begin=_with_status(STATUS_NORMAL & ~STATUS_DATA_VALID),
        says=("DataStatus 31h", "data valid", "expected 35h"),
        cure=good,
    ),
    "the PLC is in STOP": PlcSituation(
        begin=_stop, says=("the PLC is in STOP", "set the PLC to RUN"), health=Health.WARNING, cure=good
    ),
    "the PLC marks the data of the axis as bad": PlcSituation(
        begin=_mark_bad, says=("IOPS", "80h"), health=Health.WARNING, cure=good
    ),
    "the cycle counter of the PLC does not increase": PlcSituation(
        begin=changes(_same_counter), says=("cycle counter does not increase", "raise the cycle counter"), cure=good
    ),
    "the same, with a short watchdog time": PlcSituation(
        begin=changes(_same_counter),
        says=("cycle counter does not increase", "raise the cycle counter"),
        cure=good,
        transport=_SHORT,
    ),
    "the PLC does not copy the tick": PlcSituation(
        begin=changes(_without_tick),
        says=("without a tick of this gateway", "copy bytes 38 to 41"),
        cure=good,
        transport=_ROUTED,
        host="192.168.0.10",
    ),
    "the PLC sends every 20 ms, and the watchdog time is 12 ms": PlcSituation(
        begin=_every_fifth_cycle,
        says=("20 ms apart", "limit is 12 ms", "raise cycle_time_ms or watchdog_factor"),
        cure=_in_each_cycle,
        transport=_SHORT,
    ),
    "the PLC has another address than peer": PlcSituation(
        numbers=(1,),
        says=(
            "frames of 192.168.0.11",
            "the PLC is 192.168.0.10",
            'if 192.168.0.11 is the PLC, set peer = "192.168.0.11"',
        ),
        cure=lambda plc, daemon: Plc.__init__(plc, daemon, [1], "192.168.0.10") or plc.enable(),
        transport=_ROUTED,
        host="192.168.0.11",
    ),
    "the PLC acknowledges without control": PlcSituation(
        begin=_acknowledge_without_control, says=("EMCY", "STW1.7 has no effect while STW1.10 = 0"), cure=_acknowledge
    ),
    "the PLC holds the acknowledge": PlcSituation(
        begin=_hold_the_acknowledge, says=("EMCY", "needs an edge", "STW1.7 to 0 and then to 1"), cure=_acknowledge
    ),
    "the PLC acknowledges while the cause is there": PlcSituation(
        begin=_acknowledge_while_the_cause_is_there,
        says=("EMCY", "the cause is still there", "STW1.7 to 0 and then to 1"),
        cure=_acknowledge,
    ),
}
"""By what a technician finds."""


def _project(**changes: object) -> Callable[[Plant], None]:
    """The controller's project differs in this way."""

    def connect(site: Plant) -> None:
        site.plc.project = replace(site.plc.project, **changes)  # type: ignore[arg-type]
        site.plc.start(site.loop.now())

    return connect


def _other_telegram(site: Plant) -> None:
    config = site.daemon.config
    modules = profinet_model(config.transport, site.port.mac, config.objects, [telegram(9)]).modules
    _project(modules=modules)(site)


def _right_project(site: Plant) -> None:
    site.plc.project = Project("press-1", site.link.device.model.modules, data_hold=100)
    site.connect()


def _controller_status(status: int) -> Callable[[Plant], None]:
    def set_status(site: Plant) -> None:
        assert site.plc.provider is not None
        site.plc.provider.data_status = status

    return set_status


def _pull(site: Plant) -> None:
    site.port.link_up = False
    site.port.on_link()
    site.killed = True


def _plug(site: Plant) -> None:
    site.port.link_up, site.killed = True, False
    site.port.on_link()
    site.connect()


def _rename(site: Plant) -> None:
    site.plc.release(site.loop.now())
    site.until(lambda: site.plc.phase is Phase.ENDED, "released")
    site.link.station.name = ""


def _name(site: Plant) -> None:
    site.link.station.name = "press-1"
    site.connect()


@dataclass(frozen=True, kw_only=True)
class ControllerSituation:
    """As ``PlcSituation``, over PROFINET from an axis in operation."""

    begin: Callable[[Plant], None]
    says: tuple[str, ...]
    lacks: tuple[str, ...] = ("bring the PLC to RUN", "pdgw map prints")
    health: Health = Health.CRITICAL
    cure: Callable[[Plant], None]


@contextmanager
def at_controller_situation(situation: ControllerSituation, store: Path) -> Iterator[Plant]:
    """A gateway and its controller in this situation."""
    with plant(profinet_daemon.configuration(axis(1), store)) as site:
        site.connect()
        site.enable()
        situation.begin(site)
        site.run(SETTLED)
        yield site


CONTROLLER_SITUATIONS: dict[str, ControllerSituation] = {
    "the controller is in STOP": ControllerSituation(
        begin=_controller_status(STATUS_NORMAL & ~STATUS_RUN),
        says=("the PLC is in STOP", "set the PLC to RUN"),
        lacks=("cable",),
        health=Health.WARNING,
        cure=_controller_status(STATUS_NORMAL),
    ),
    "the controller marks the data of the axis as bad": ControllerSituation(
        begin=lambda site: site.plc.set_output((1, 2), bytes(4), good=False),
        says=("IOPS",),
        lacks=("cable",),
        health=Health.WARNING,
        cure=lambda site: None,
    ),
    "the project of the controller has another telegram": ControllerSituation(
        begin=_other_telegram,
        says=("the controller's project has no telegram 1 in slot 1", "modules"),
        lacks=("cable", "IOPS"),
        health=Health.WARNING,
        cure=_right_project,
    ),
    "the device rejects the controller's project": ControllerSituation(
        begin=_project(data_hold=0),
        says=("Connect from 192.168.0.1 rejected", "IocrBlockReq.watchdog"),
        lacks=("cable",),
        cure=_right_project,
    ),
    "the Ethernet cable is off": ControllerSituation(
        begin=_pull, says=("the Ethernet cable of eth1 is off", "plug the cable"), cure=_plug
    ),
    "the device has no name of station": ControllerSituation(
        begin=_rename, says=("no name of station", "DCP"), lacks=("cable",), cure=_name
    ),
}
"""By what a technician finds."""
