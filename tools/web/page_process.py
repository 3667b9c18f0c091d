"""``pdgw web`` as a process: the server, the watch and, if configured, the MQTT publisher, until a signal ends it."""

from __future__ import annotations

import asyncio
import socket

from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.errors import GatewayError
from pdgw.tools.web.app import Capture, Parameters, made_app
from pdgw.tools.web.server.guard import Token, read_token
from pdgw.tools.web.server.server import PageServer, Places, listen, made_server
from pdgw.tools.web.status.watch import StatusPort, Watch, log


def serve(config: GatewayConfig, parameters: Parameters, capture: Capture) -> None:
    """Serve the page of the gateway with this configuration until SIGINT or SIGTERM.

    GatewayError when its port, token or certificate cannot be used, or when the gateway has no status port.
    """
    status_port = config.transport.status_port
    if not status_port:
        raise GatewayError("[transport] status_port = 0: the page needs the status port; set another port")
    web = config.web
    token = None if web.token_file is None else Token(read_token(web.token_file))
    watch = Watch(config, StatusPort(status_port))
    publisher = None
    if config.mqtt is not None:
        from pdgw.tools.web.mqtt import Publisher  # noqa: PLC0415 (of an extra of its own)

        publisher = Publisher(config.mqtt, watch)
        watch.feed.listeners.append(publisher.publish_changes)
    server = made_page(watch, parameters, capture, token)
    with listen(web) as port:
        log.info("page at %s", page_address(port, tls=web.tls_cert is not None))
        if publisher is not None:
            publisher.start()
        try:
            asyncio.run(server.serve(sockets=[port]))
        finally:
            if publisher is not None:
                publisher.stop()


def made_page(watch: Watch, parameters: Parameters, capture: Capture, token: Token | None) -> PageServer:
    """The server of the page with its limits, not started."""
    places = Places()
    app, streams = made_app(watch, parameters, capture, token, places)
    return made_server(app, streams, places, watch.config.web)


def page_address(port: socket.socket, *, tls: bool) -> str:
    """The address to open in a browser."""
    host, number = port.getsockname()[:2]
    name = f"[{host}]" if ":" in host else host
    return f"http{'s' if tls else ''}://{name}:{number}/"
