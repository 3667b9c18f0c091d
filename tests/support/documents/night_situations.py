"""Situations that a technician finds at night: the first guess is wrong, and the line has to name what is true."""

from __future__ import annotations

from pdgw.base.durations import SECOND
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.tools.output.status_text import Health
from tests.support.documents.origin_situations import find
from tests.support.documents.situations import Situation, Step, both, online, run_out, words
from tests.support.gateways.daemon import OFF, ON, Plc, axis, drive_of, world_of

_AGAIN = words((OFF, {}), (ON, {}))


def _wait(seconds: int) -> Step:
    return lambda plc, _: run_out(plc, seconds * SECOND)


def _darken(_: Plc, daemon: Daemon) -> None:
    """No device of the bus has power: nobody acknowledges."""
    for item in daemon.objects:
        drive_of(daemon, item.node_id).node.power_off()


def _light(plc: Plc, daemon: Daemon) -> None:
    for item in daemon.objects:
        drive_of(daemon, item.node_id).node.restart()
    online(plc, daemon)


def _start_dark(daemon: Daemon) -> None:
    drive_of(daemon).node.power_off()


def _short(restart_ns: int | None) -> Step:
    """A short circuit for half a second; ``restart_ns`` as of a ``Member``."""

    def step(plc: Plc, daemon: Daemon) -> None:
        world_of(daemon).gateway_port("world").restart_ns = restart_ns
        world_of(daemon).bus("world").short(True)
        run_out(plc, SECOND // 2)
        world_of(daemon).bus("world").short(False)

    return step


def _restart_interface(plc: Plc, daemon: Daemon) -> None:
    world_of(daemon).unplug("world")
    run_out(plc, SECOND // 10)
    world_of(daemon).unplug("world", False)
    online(plc, daemon)


def _pause(plc: Plc, daemon: Daemon) -> None:
    """The machine of the gateway is paused for 4 s."""
    world_of(daemon).loop.pause(4 * SECOND)
    plc.until(lambda: not daemon.axes[0].released, "the stop")
    find(plc, daemon)


_DARK = ("bus can: no device on the bus acknowledges a frame", "Check the supply of the devices, then the CAN cable")
NIGHT_SITUATIONS: dict[str, Situation] = {
    "all drives of the bus lose their supply": Situation(
        begin=_darken,
        tables=axis(1) + axis(2) + axis(3),
        says=("axes 1-3 Not on the bus: ", *_DARK),
        lacks=("bus-off", "interface"),
        cure=_light,
    ),
    "the gateway starts, and the only drive has no power": Situation(
        operates=False,
        spoil=_start_dark,
        says=("Not on the bus: ", *_DARK),
        lacks=("bus-off", "interface"),
        cure=_light,
    ),
    "a short circuit of the bus, and the interface does not restart": Situation(
        begin=both(_short(None), _wait(6)),
        says=("Not on the bus: bus can: bus-off, and the interface does not restart", "restart-ms 100"),
        lacks=("by itself again", "connects again"),
        cure=_restart_interface,
    ),
    "the machine of the gateway is paused for some seconds in operation": Situation(
        begin=_pause,
        says=(
            "Waits: ON ignored: ",
            "the gateway did not run for 4 s (machine paused",
            "Find what pauses or overloads the machine",
            "; then OFF and ON",
        ),
        lacks=("TPDO", "cable", "no valid frame"),
        health=Health.WARNING,
        cure=_AGAIN,
    ),
}
"""What a technician finds, over both links."""
