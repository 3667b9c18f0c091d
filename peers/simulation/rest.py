"""The simulators' REST interface on loopback: devices, the catalogue of faults, and faults set and removed at run time.

| request | answer |
| --- | --- |
| GET /devices, GET /devices/{node} | status and faults in force |
| GET /faults | the catalogue: description, parameters, limits |
| POST /devices/{node}/faults/{name} | sets a fault; the body is a JSON object of parameters, or empty |
| DELETE /devices/{node}/faults/{name}, DELETE /devices/{node}/faults | removes one, or all |

Answers are JSON; an error is ``{"error": "..."}`` with status 400, 403, 404, 405 or 413. Left out: authentication and TLS,
because it listens on 127.0.0.1 only; a request that a web page could have sent (foreign Host, or an Origin) is refused.
"""

from __future__ import annotations

import contextlib
import json
import sys
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from pdgw.ds301.errors import CanopenError
from pdgw.gateway.errors import GatewayError
from pdgw.peers.simulation.devices import Simulation, fault_catalogue
from pdgw.peers.simulation.tcp import PatientServer

_MAXIMUM_BODY = 65536
_STOP_POLL_S = 0.05
_LOCAL = ("127.0.0.1", "localhost")


class _RefusedError(Exception):
    def __init__(self, status: int, text: str) -> None:
        self.status = status
        super().__init__(text)


class _Server(PatientServer, ThreadingHTTPServer):
    def handle_error(self, request: object, client_address: object) -> None:
        """Who went away in the middle of a request is no error of ours; anything else is shown."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)  # type: ignore[arg-type]


class RestServer:
    """Serves from construction until ``stop``; GatewayError when the port cannot be had. Port 0 takes any free one."""

    def __init__(self, simulation: Simulation, port: int) -> None:
        class Handler(_Handler):
            pass

        Handler.simulation = simulation
        try:
            self._server = _Server(("127.0.0.1", port), Handler)
        except OSError as error:
            raise GatewayError(f"REST port: 127.0.0.1 port {port} cannot be used ({error.strerror})") from error
        self._thread = threading.Thread(
            target=self._server.serve_forever, args=(_STOP_POLL_S,), name="REST", daemon=True
        )
        self._thread.start()

    @property
    def port(self) -> int:
        """The port it listens on."""
        return int(self._server.server_address[1])

    def stop(self) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Handler(BaseHTTPRequestHandler):
    simulation: Simulation
    protocol_version = "HTTP/1.1"
    timeout = 10

    def do_GET(self) -> None:
        self._answer(self._get)

    def do_POST(self) -> None:
        self._answer(self._post)

    def do_DELETE(self) -> None:
        self._answer(self._delete)

    def log_message(self, format: str, *args: object) -> None:
        """Requests are not logged: standard error belongs to the simulator."""

    def _answer(self, action: Callable[[list[str]], object]) -> None:
        status = 200
        answer: object
        try:
            host = self.headers.get("Host", _LOCAL[0]).rsplit(":", 1)[0]
            if host not in _LOCAL or "Origin" in self.headers:
                raise _RefusedError(403, "only programs on this machine may ask")
            answer = action([part for part in self.path.partition("?")[0].split("/") if part])
        except _RefusedError as error:
            status, answer = error.status, {"error": str(error)}
        except CanopenError as error:
            status, answer = 400, {"error": str(error)}
        body = json.dumps(answer, indent=2).encode() + b"\n"
        if status >= 400:
            self.close_connection = True  # a body that was not read would be taken for the next request
        with contextlib.suppress(OSError):
            self.send_response(status)
            self.send_header("Content-Type", "application/json")
            self.send_header("Content-Length", str(len(body)))
            if self.close_connection:
                self.send_header("Connection", "close")
            self.end_headers()
            self.wfile.write(body)

    def _get(self, path: list[str]) -> object:
        match path:
            case ["faults"]:
                return fault_catalogue()
            case ["devices"]:
                return [self.simulation.status(node) for node in self.simulation.nodes]
            case ["devices", node]:
                return self.simulation.status(self._node(node))
        raise self._nothing_here(path)

    def _post(self, path: list[str]) -> object:
        match path:
            case ["devices", number, "faults", name]:
                node = self._node(number)
                self._known(node, name)
                self.simulation.misbehave(node, name, self._body())
                return self.simulation.status(node)
        raise self._nothing_here(path)

    def _delete(self, path: list[str]) -> object:
        match path:
            case ["devices", number, "faults", *name] if len(name) <= 1:
                node = self._node(number)
                if name:
                    self._known(node, name[0])
                self.simulation.behave(node, name[0] if name else None)
                return self.simulation.status(node)
        raise self._nothing_here(path)

    def _node(self, text: str) -> int:
        if text.isascii() and text.isdecimal() and len(text) <= 3 and int(text) in self.simulation.nodes:
            return int(text)
        raise _RefusedError(404, f"node {text!r} is not simulated, there are {self.simulation.nodes}")

    def _known(self, node: int, name: str) -> None:
        known = self.simulation.device(node).node.catalogue
        if name not in known:
            raise _RefusedError(404, f"fault {name!r} does not exist, there are {', '.join(known)}")

    def _body(self) -> dict[str, object]:
        length = self.headers.get("Content-Length", "0")
        if not length.isascii() or not length.isdecimal() or len(length) > 9 or int(length) > _MAXIMUM_BODY:
            raise _RefusedError(413, f"Content-Length {length[:20]!r}: 0 to {_MAXIMUM_BODY} bytes are taken")
        try:
            text = self.rfile.read(int(length))
            body = json.loads(text) if text.strip() else {}
        except (ValueError, RecursionError, OSError):
            raise _RefusedError(400, "the body is no JSON") from None
        if not isinstance(body, dict):
            raise _RefusedError(400, "the body must be a JSON object of parameters")
        return body

    def _nothing_here(self, path: list[str]) -> _RefusedError:
        known = path[:1] in (["devices"], ["faults"])
        return _RefusedError(
            405 if known else 404, f"{self.command} {self.path[:80]!r} is not offered: see GET /devices, /faults"
        )
