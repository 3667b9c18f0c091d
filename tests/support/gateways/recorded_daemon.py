"""Recordings that a whole gateway makes of itself in virtual time, with a PLC and simulated devices."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.trace.reader import RingReader
from pdgw.gateway.trace.recorder import FlightRecorder
from pdgw.tools.decoder.step_replay import Difference, Replayed
from pdgw.tools.recording.recordings import replayed
from pdgw.tools.recording.trace_keeper import save
from tests.support.gateways.daemon import Plc, running


def record(daemon: Daemon, folder: Path) -> FlightRecorder:
    """The recorder of a daemon that was not started yet; its ring is in ``folder``."""
    recorder = FlightRecorder(daemon, folder, "test")
    daemon.services.append(recorder)
    return recorder


@contextmanager
def recorded(
    config: GatewayConfig, folder: Path, before: Callable[[Daemon], None] = lambda daemon: None
) -> Iterator[Plc]:
    """A PLC and its gateway, which records itself."""
    made: list[Plc] = []

    def prepare(daemon: Daemon) -> None:
        before(daemon)
        record(daemon, folder)
        made.append(Plc(daemon, [item.telegram for item in config.objects]))

    with running(config, prepare):
        yield made[0]


def recording(folder: Path) -> str:
    """Everything that the ring in ``folder`` has, in one file."""
    file = folder / "gateway.pcapng"
    reader = RingReader(folder / "test.ring")
    save(reader, file)
    return str(file)


def replay_of(folder: Path) -> list[Replayed]:
    """Replay a recording from its start."""
    return replayed([recording(folder)])


def differences(results: Sequence[Replayed]) -> list[Difference]:
    """Those of all drive objects."""
    return [difference for result in results for difference in result.differences]
