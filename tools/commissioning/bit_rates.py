"""Listen to a bus at other bit rates, and say what to try when no device answers. Nothing is sent."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

import can

from pdgw.base.durations import SECOND
from pdgw.base.phrases import counted
from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.bus.load import DEFAULT_BITRATE
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.communication import LSS_BIT_TIMINGS
from pdgw.gateway.base.platform import Platform
from pdgw.gateway.configuration.environment import CanConfig
from pdgw.tools.bus_task import complete, opened

_LISTEN_NS: Final = SECOND
_SILENT: Final[Mapping[str, Mapping[str, object]]] = {
    "pcan": {"state": can.BusState.PASSIVE},
    "slcan": {"listen_only": True},
    "pdgw-bus": {},
    "virtual": {},
}
"""Keys with which an interface only listens: at a wrong bit rate it would otherwise disturb a bus that works."""


def listen(config: CanConfig, platform: Platform | None = None) -> Iterator[str]:
    """Yield one line for each other bit rate: what was heard, or the commands with which a user listens."""
    silent = _SILENT.get(config.interface)
    present = config.bitrate or DEFAULT_BITRATE
    for rate in LSS_BIT_TIMINGS:
        if rate == present:
            continue
        if config.interface == "socketcan":
            name = config.channel or "can0"
            yield (
                f"{rate} bit/s: sudo ip link set {name} down; sudo ip link set {name} up type can bitrate {rate} listen-only on; "
                f"candump -n 5 {name}"
            )
        elif silent is None:
            yield f"{rate} bit/s: {config.interface} has no known way to listen only; set the bit rate and listen by hand"
        else:
            yield f"{rate} bit/s: {_heard(CanConfig(**{**config.model_dump(), **silent, 'bitrate': rate}), platform)}"


def _heard(config: CanConfig, platform: Platform | None) -> str:
    try:
        with opened(config, platform) as network:
            complete(network.loop, lambda: network.loop.sleep(_LISTEN_NS))
            frames, errors = network.received, network.health.error_frames
    except CanopenError as error:
        return str(error)
    if frames:
        return f"{counted(frames, 'frame')} heard: this is the bit rate of the bus"
    return f"nothing heard, {counted(errors, 'error frame')}"


def hints(network: CanNetwork, bitrate: int | None) -> Iterator[str]:
    """What to try when no device was found."""
    rate = bitrate or DEFAULT_BITRATE
    if network.health.error_frames or network.health.bus_off or network.health.error_passive:
        counts = {
            "error frame": network.health.error_frames,
            "time error-passive": network.health.error_passive,
            "bus-off": network.health.bus_off,
        }
        shown = ", ".join(counted(number, what) for what, number in counts.items() if number)
        yield f"the adapter reports {shown}: another bit rate than {rate} bit/s, a wrong termination, or a cable"
    else:
        yield f"the adapter reports no error: {rate} bit/s may be right; check supply and cable of the devices"
    yield "listen at the other usual bit rates: pdgw bus scan --bitrates"
    yield "measure 60 ohm between CAN_H and CAN_L without power: two terminations of 120 ohm"
    yield "a device that is not stopped answers no LSS; one without LSS has switches or an object of its maker"
