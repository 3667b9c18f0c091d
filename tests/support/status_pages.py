"""Pages of simulated gateways on loopback, all in one thread: each answers with what it was given.

``python -m tests.support.status_pages 200`` measures ``pdgw status --fleet`` with 200 of them.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from pdgw.gateway.reasons import AxisState, Reason
from tests.support.cli import pdgw

Response = tuple[int, bytes]
"""HTTP status and body."""


def document(name: str, reason: Reason | None = None, axes: int = 4) -> dict[str, Any]:
    """What of a status document the table reads; with a reason its axes are not in operation."""
    state = AxisState.OBEYS if reason is None else reason.state
    items = [{"do_id": n, "label": f"axis {n}", "state_id": state.name, "faults": []} for n in range(1, axes + 1)]
    cause = reason and {
        "state": state.value,
        "state_id": state.name,
        "reason": reason.value,
        "reason_id": reason.name,
        "remedy": reason.remedy,
        "who": f"axes 1-{axes}",
        "objects": list(range(1, axes + 1)),
    }
    return {
        "name": name,
        "uptime_s": 1,
        "plc": {"connected": reason is not Reason.NO_PLC},
        "buses": [{"name": "can", "healthy": True}],
        "causes": [cause] if cause else [],
        "axes": items,
        "encoders": [],
    }


@contextlib.contextmanager
def pages(responses: Sequence[Response]) -> Iterator[list[tuple[int, list[bytes]]]]:
    """The port of each page, and the requests that it got."""
    loop = asyncio.new_event_loop()
    served: list[tuple[int, list[bytes]]] = []

    async def begin(status: int, body: bytes) -> asyncio.Server:
        requests: list[bytes] = []

        async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            requests.append(await reader.readuntil(b"\r\n\r\n"))
            writer.write(
                b"HTTP/1.1 %d x\r\nContent-Length: %d\r\nConnection: close\r\n\r\n" % (status, len(body)) + body
            )
            await writer.drain()
            writer.close()

        server = await asyncio.start_server(answer, "127.0.0.1", 0)
        served.append((server.sockets[0].getsockname()[1], requests))
        return server

    servers = [loop.run_until_complete(begin(*response)) for response in responses]
    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    try:
        yield served
    finally:
        for server in servers:
            loop.call_soon_threadsafe(server.close)
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()


def inventory(path: Path, ports: Mapping[str, int], **variables: object) -> Path:
    """An Ansible inventory of these gateways."""
    hosts = {name: {"pdgw_page_port": port} for name, port in ports.items()}
    content = {"all": {"children": {"gateways": {"vars": {"ansible_host": "127.0.0.1", **variables}, "hosts": hosts}}}}
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def main(count: int) -> None:
    """Measure once and print."""
    reasons = [None, None, None, None, None, None, None, Reason.NO_PLC, Reason.NEEDS_OFF, Reason.PLC_LOST]
    responses = [(200, json.dumps(document(f"g{n}", reasons[n % len(reasons)])).encode()) for n in range(count)]
    with tempfile.TemporaryDirectory() as folder, pages(responses) as served:
        path = inventory(Path(folder) / "hosts.yml", {f"g{n:03}": port for n, (port, _) in enumerate(served)})
        begin = time.monotonic()
        done = pdgw("status", "--fleet", str(path))
        print(
            done.stdout,
            done.stderr,
            f"{count} gateways in {time.monotonic() - begin:.2f} s, exit status {done.returncode}",
        )


if __name__ == "__main__":
    main(int(sys.argv[1]))
