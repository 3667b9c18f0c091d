"""Recordings of a whole gateway in virtual time, with a PLC and simulated devices."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pdgw.decoder.frames.engine import Settings
from pdgw.decoder.frames.profinet.cyclic import Axis
from pdgw.recording.recordings import Known, Loaded, load
from tests.support.axis.recorded import Frames
from tests.support.gateways.daemon import Plc, configuration, running


class RecordedPlc(Plc):
    """A PLC whose frames, the answers and the frames on CAN are kept."""

    def __init__(self, *args: object) -> None:
        super().__init__(*args)  # type: ignore[arg-type]
        self.frames = Frames()
        bus = self.daemon.networks["can"].listeners
        bus.append(
            lambda message: self.frames.can.append((self.loop.now(), message.arbitration_id, bytes(message.data)))
        )

    def _take(self) -> None:
        while (datagram := self.port.receive()) is not None:
            self.frames.answers.append((self.loop.now(), bytes(datagram[0])))
            self.endpoint.receive(datagram[0], self.loop.now())

    def send(self) -> None:
        frame = bytes(self.endpoint.build(self.loop.now()))
        self.frames.plc.append((self.loop.now(), frame))
        self.port.send(frame, self.daemon.address)

    def replayed(self, folder: Path) -> Loaded:
        config = self.daemon.config
        axes = [Axis(item.do_id, item.telegram, item.node_id) for item in config.objects]
        settings = {item.do_id: item.settings_at(config.transport.cycle_time_ms) for item in config.axis}
        known = Known(Settings(axes), settings, self.daemon.cycle_ns, config.transport.watchdog_factor)
        return load(self.frames.write(folder), known, 0, lambda _: None)


@contextmanager
def recorded(numbers: list[int], tables: str) -> Iterator[RecordedPlc]:
    made: list[RecordedPlc] = []
    config = configuration(tables)
    with running(config, lambda daemon: made.append(RecordedPlc(daemon, numbers))) as daemon:
        assert daemon.config is config
        yield made[0]


def only(loaded: Loaded) -> list[tuple[str, tuple[str, ...]]]:
    outcome = loaded.replay(first_only=True)[0]
    assert outcome.differences or outcome.compared > 50
    return [(item.what, item.names) for item in outcome.differences]
