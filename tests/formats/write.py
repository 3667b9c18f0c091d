"""Write the files of a release, once: ``python -m tests.formats.write VERSION``. They are never changed later."""

from __future__ import annotations

import gzip
import json
import sys
import tempfile
from pathlib import Path

from pdgw.base.durations import SECOND
from pdgw.gateway.base.store import DeviceParameters, DoParameters
from pdgw.gateway.configuration.file import config_text, parse_config
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.parameters.acyclic import AcyclicServer
from pdgw.gateway.trace.reader import RingReader
from pdgw.gateway.trace.recorder import FlightRecorder
from pdgw.tools.recording.trace_keeper import part_of
from pdgw.tools.web.parameters import PageParameters
from tests.support.gateways.daemon import Plc, exchanging, reached, running, until

HERE = Path(__file__).parent
CONFIGURATION = """
[can]
interface = "virtual"
channel = "formats"
[transport]
cyclic_port = 0
acyclic_port = 0
status_port = 0
cycle_time_ms = 20
watchdog_factor = 75
[trace]
seconds = 10
[[axis]]
do_id = 1
node_id = 1
telegram = 1
simulate = true
"""


def write(folder: Path) -> None:
    """Configuration, store, parameter dump and recording of an axis that was enabled, turned and stopped."""
    folder.mkdir(parents=True)
    config = parse_config(CONFIGURATION)
    (folder / "gateway.toml").write_text(config_text(config), encoding="utf-8")
    servers: list[AcyclicServer] = []
    with tempfile.TemporaryDirectory() as name:
        run_directory = Path(name)

        def before(daemon: Daemon) -> None:
            servers.append(AcyclicServer(daemon))
            daemon.services += [servers[0], FlightRecorder(daemon, run_directory, "gateway")]

        with running(config.model_copy(update={"store": folder / "store.json"}), before) as daemon:
            until(daemon, lambda: daemon.clients[0].generation, "node online")
            with reached(daemon):
                dump = PageParameters(servers[0].address).dump(1)
            _compress(folder / "dump.json", json.dumps(dump, indent=1).encode())

            def change(parameters: DeviceParameters) -> None:
                parameters.im1_function = "conveyor 3"
                parameters.objects[1] = DoParameters(telegram=2, sign_of_life_tolerance=5, name="infeed")

            daemon.store.update(change)
            plc = Plc(daemon, [1])
            plc.enable()
            plc.endpoint.set(0, {"NSOLL_A": 0x1000})
            plc.until(lambda: plc.value("NIST_A") == 0x1000, "speed")
            plc.endpoint.set(0, {"STW1": 0x047E})
            plc.until(lambda: plc.state() == 0x01, "off")
            with exchanging(plc):
                plc.loop.run_for(SECOND // 2)
        reader = RingReader(run_directory / "gateway.ring")
        _compress(folder / "recording.pcapng", part_of(reader)[0])


def _compress(path: Path, data: bytes) -> None:
    path.with_name(f"{path.name}.gz").write_bytes(gzip.compress(data, mtime=0))


if __name__ == "__main__":
    write(HERE / sys.argv[1])
