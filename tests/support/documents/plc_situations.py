"""Situations in which the frames of the PLC, or the project of a controller, are the cause."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from pdgw.base.durations import SECOND
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.links.profinet.station import profinet_model
from pdgw.peers.controller.controller import Phase
from pdgw.profidrive.frame import STATUS_DATA_VALID, STATUS_NORMAL, TRAILER
from pdgw.profidrive.telegrams import telegram
from pdgw.profinet.rpc.dcerpc import PacketType
from pdgw.tools.output.status_text import Health
from tests.support.documents.situations import Situation, Step, both, good, run_out
from tests.support.gateways.daemon import OFF, Plc, world_of
from tests.support.gateways.profinet_daemon import OTHER_IP, ControllerPlc, Plant, abort, try_to_connect
from tests.support.wire.profinet import PLC_IP, PLC_MAC

_SHORT = "cycle_time_ms = 4\nwatchdog_factor = 3"
_ROUTED = 'cycle_time_ms = 4\nwatchdog_factor = 75\nlisten = "192.168.0.5"\npeer = "192.168.0.10"'


@dataclass(frozen=True, kw_only=True)
class PlcSituation(Situation):
    """A situation whose cause is the PLC."""

    lacks: tuple[str, ...] = ("check the cable", "bring the PLC to RUN", "no valid frame from the PLC yet")


def changes(change: Callable[[bytearray], bytes]) -> Step:
    """The PLC sends frames that are changed in this way."""

    def begin(plc: Plc, _: Daemon) -> None:
        plc.change = change

    return begin


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


def _laptop(plc: Plc, daemon: Daemon) -> None:
    """Another sender's frames, some seconds before."""
    port = world_of(daemon).network.open("laptop", 0, "PLC")
    port.send(bytes(46), daemon.address)
    run_out(plc, 2 * SECOND)


PLC_SITUATIONS: dict[str, PlcSituation] = {
    "the PLC sends a longer telegram": PlcSituation(
        numbers=(111,),
        operates=False,
        says=("frames of", "expected: 46 bytes for telegrams 1", "pdgw map"),
        cure=right_layout,
    ),
    "the PLC sends another telegram of the same length": PlcSituation(
        numbers=(102,),
        operates=False,
        begin=lambda plc, _: plc.endpoint.set(0, {"STW1": OFF, "MOMRED": 1}),
        says=("byte 11 is not 0", "expected: 46 bytes for telegrams 1", "pdgw map"),
        cure=right_layout,
    ),
    "the PLC sends one axis too many": PlcSituation(
        numbers=(1, 1),
        operates=False,
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
    "another sender's frames come, then the PLC is silent": PlcSituation(
        begin=both(_laptop, lambda plc, _: setattr(plc, "silent", True)),
        says=("PLC lost: no valid frame for ", " cycles, since ", "check the cable"),
        lacks=("laptop", "do not count"),
        cure=good,
    ),
    "the PLC has another address than peer": PlcSituation(
        numbers=(1,),
        operates=False,
        says=(
            "frames of 192.168.0.11",
            "the PLC is 192.168.0.10",
            'if 192.168.0.11 is the PLC, set peer = "192.168.0.11"',
        ),
        cure=lambda plc, daemon: Plc.__init__(plc, daemon, [1], "192.168.0.10") or plc.enable(),
        transport=_ROUTED,
        host="192.168.0.11",
    ),
}
"""What a technician finds, over UDP."""


def _at(act: Callable[[Plant], None]) -> Step:
    """Something happens to the controller or its network."""

    def step(plc: Plc, _: Daemon) -> None:
        assert isinstance(plc, ControllerPlc)
        act(plc.site)

    return step


def _project(site: Plant, **changes: object) -> None:
    """The controller's project differs in this way."""
    site.plc.project = replace(site.plc.project, **changes)  # type: ignore[arg-type]
    site.plc.start(site.loop.now())


def _other_telegram(site: Plant) -> None:
    config = site.daemon.config
    _project(site, modules=profinet_model(config.transport, site.port.mac, config.objects, [telegram(9)]).modules)


def _right_project(site: Plant) -> None:
    _project(site, modules=site.link.device.model.modules, data_hold=100)


def _pull(site: Plant) -> None:
    site.port.link_up = False
    site.port.on_link()
    site.killed = True


def _plug(site: Plant) -> None:
    site.port.link_up, site.killed = True, False
    site.port.on_link()


def _silent(plc: Plc, _: Daemon) -> None:
    plc.silent = True


def _alive(site: Plant) -> None:
    site.killed = False
    site.plc.phase = Phase.ENDED


def _never_connect(plc: Plc, _: Daemon) -> None:
    assert isinstance(plc, ControllerPlc)
    plc.retry = 1 << 62


def _try_again(plc: Plc, _: Daemon) -> None:
    assert isinstance(plc, ControllerPlc)
    plc.retry = 0


def _rename(site: Plant) -> None:
    site.plc.release(site.loop.now())
    site.until(lambda: site.plc.phase is Phase.ENDED, "released")
    site.link.station.name = ""


def _name(site: Plant) -> None:
    site.link.station.name = "press-1"


def _block_calls(site: Plant) -> None:
    """A firewall drops the calls to the controller."""
    receive = site.plc.on_datagram
    site.plc.on_datagram = lambda data, *more: None if data[1] == PacketType.REQUEST else receive(data, *more)  # type: ignore[method-assign]
    site.plc.start(site.loop.now())


def _pass_calls(site: Plant) -> None:
    del site.plc.on_datagram  # type: ignore[method-assign]
    site.plc.start(site.loop.now())


CONTROLLER_SITUATIONS: dict[str, PlcSituation] = {
    "the project of the controller has another telegram": PlcSituation(
        begin=_at(_other_telegram),
        says=(
            "slot 1: the controller's project has axis with telegram 9, configured is axis with telegram 1",
            "modules",
        ),
        lacks=("cable", "IOPS"),
        health=Health.WARNING,
        cure=both(_at(_right_project), good),
    ),
    "the controller does not receive the calls of the device": PlcSituation(
        begin=_at(_block_calls),
        says=("has connected, but has not confirmed ApplicationReady since", "UDP port 34964", "firewall"),
        lacks=("cable", "no controller"),
        cure=both(_at(_pass_calls), good),
    ),
    "the device rejects the controller's project": PlcSituation(
        begin=_at(lambda site: _project(site, data_hold=0)),
        says=("Connect from 192.168.0.1 rejected", "IocrBlockReq.watchdog"),
        lacks=("cable",),
        cure=both(_at(_right_project), good),
    ),
    "another controller is rejected, then the controller is silent": PlcSituation(
        begin=both(_at(try_to_connect), _silent),
        says=("PLC lost: no valid frame for 12 cycles, since ", "check the cable"),
        lacks=("rejected", OTHER_IP),
        cure=good,
    ),
    "the controller's project was rejected once before, then the controller is silent": PlcSituation(
        operates=False,
        begin=both(_at(lambda site: try_to_connect(site, PLC_IP, PLC_MAC, data_hold=0)), good, _silent),
        says=("PLC lost: no valid frame for 12 cycles, since ", "check the cable"),
        lacks=("rejected",),
        cure=good,
    ),
    "the controller ends the relationship with an error": PlcSituation(
        begin=_at(abort(0x24)),
        says=("PLC lost: the relationship has ended: the controller sent an alarm ERR (CF 81 FD 24), since ",),
        lacks=("0D",),
        cure=both(_at(_alive), good),
    ),
    "no controller has connected": PlcSituation(
        operates=False,
        begin=_never_connect,
        says=("no controller has connected to the name of station press-1", "modules and telegrams", "pdgw map"),
        lacks=("port", "no valid frame"),
        cure=both(_try_again, good),
    ),
    "the Ethernet cable is off": PlcSituation(
        begin=_at(_pull), says=("the Ethernet cable of eth1 is off", "plug the cable"), cure=both(_at(_plug), good)
    ),
    "the device has no name of station": PlcSituation(
        begin=_at(_rename), says=("no name of station", "DCP"), lacks=("cable",), cure=both(_at(_name), good)
    ),
}
"""What a technician finds, over PROFINET."""
