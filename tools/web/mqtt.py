"""Publish to an MQTT broker: the state of each drive object when it changes, and events. Nothing is received from it.

    TOPIC/NAME/online               "1"; "0" is the last will, and sent while the gateway does not answer   retained
    TOPIC/NAME/axis/DO/state        {"state", "sentence", "reason", "remedy", "fault", ...} on change               retained
    TOPIC/NAME/encoder/DO/state     the same
    TOPIC/NAME/event                one event as in the page's list

paho's own thread connects and reconnects. Messages wait in its queue for a limited time: after a new connection the present
states are sent, not those of the outage.
"""

from __future__ import annotations

import contextlib
import json
import re
import socket
import ssl
import threading
import uuid
from dataclasses import asdict

from paho.mqtt.client import Client, ConnectFlags
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from pdgw.base.files import read_file
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.defaults import STATUS_PORT
from pdgw.gateway.configuration.web import MqttConfig
from pdgw.tools.web.status.feed import Document
from pdgw.tools.web.status.watch import Watch, log

_QOS = 1
_PASSWORD_MAX = 4096
_KEEP_ALIVE_S = 15
_RECONNECT_MAX_S = 30
MESSAGE_MAX = 64 * 1024
"""Bytes of a packet of the broker. It sends acknowledgements of a few bytes; MQTT itself allows 256 MB."""
_STATE_KEYS = ("name", "state", "state_id", "sentence", "reason", "reason_id", "remedy", "drive", "telegram")


def topic_name(config: GatewayConfig) -> str:
    """The gateway in topics: its name, else its computer's, which no other gateway on the broker has."""
    if config.name is not None:
        return config.name
    host = re.sub(r"[^\w.-]", "-", socket.gethostname())
    return host if config.transport.status_port == STATUS_PORT else f"{host}-{config.transport.status_port}"


def object_message(item: Document) -> str:
    """Message on a drive object, without values that change in normal operation, such as a speed."""
    fault = item["cause"] or (item["faults"][0] if item["faults"] else None)
    newest = None if fault is None else {key: fault[key] for key in ("number", "text", "is_warning", "active", "time")}
    return json.dumps({key: item[key] for key in _STATE_KEYS} | {"fault": newest})


class BoundedClient(Client):
    """paho's client, which would collect any packet in memory: a large one ends the connection."""

    def _sock_recv(self, bufsize: int) -> bytes:
        """``bufsize``: missing bytes of a packet."""
        if bufsize > MESSAGE_MAX:
            log.warning("MQTT: message of %d bytes from the broker rejected, allowed: %d", bufsize, MESSAGE_MAX)
            raise ConnectionError("message too large")
        return super()._sock_recv(bufsize)


def made_client(config: MqttConfig, client_id: str) -> Client:
    """A client that is not connected; GatewayError when its files cannot be used."""
    client = BoundedClient(CallbackAPIVersion.VERSION2, client_id=client_id, reconnect_on_failure=True)
    if config.username is not None:
        password = None
        if config.password_file is not None:
            try:
                password = read_file(config.password_file, _PASSWORD_MAX).decode().strip()
            except (OSError, UnicodeDecodeError) as error:
                raise GatewayError(f"[mqtt] password_file {config.password_file}: cannot be read ({error})") from error
        client.username_pw_set(config.username, password)
    if config.tls:
        try:
            client.tls_set_context(ssl.create_default_context(cafile=None if config.tls is True else config.tls))
        except OSError as error:
            raise GatewayError(f"[mqtt] tls {config.tls}: cannot be used ({error})") from error
    client.reconnect_delay_set(1, _RECONNECT_MAX_S)
    return client


class Publisher:
    """Publish the state of the gateway of a watch to a broker, from ``start`` to ``stop``. ``name``: of the gateway, for the
    topics."""

    def __init__(self, config: MqttConfig, watch: Watch) -> None:
        self._config = config
        self._watch = watch
        self._base = f"{config.topic}/{topic_name(watch.config)}"
        self._published: dict[str, str] = {}
        self._last_event: int | None = None
        self._reconnected = threading.Event()
        self._ready = threading.Event()
        self._client = made_client(config, f"pdgw-{uuid.uuid4().hex[:16]}")
        self._client.will_set(self._online_topic, "0", _QOS, retain=True)
        # paho connects before it calls on_connect. Messages published in between would be published again as after an
        # outage.
        self._client.on_pre_connect = lambda *_: self._ready.clear()
        self._client.on_connect = self._connected
        self._client.on_connect_fail = lambda *_: log.warning("MQTT: %s:%d cannot be reached", config.host, config.port)

    @property
    def _online_topic(self) -> str:
        return f"{self._base}/online"

    @property
    def connected(self) -> bool:
        """The broker is connected; new messages belong to this connection."""
        return self._client.is_connected() and self._ready.is_set()

    def start(self) -> None:
        """Connect as soon as the broker is there."""
        self._client.connect_async(self._config.host, self._config.port, _KEEP_ALIVE_S)
        self._client.loop_start()

    def stop(self) -> None:
        """Say good-bye: who ends in order is not online either."""
        if self.connected:
            # paho's error for a connection lost meanwhile: then the broker publishes the last will with the same content.
            with contextlib.suppress(RuntimeError):
                self._client.publish(self._online_topic, "0", _QOS, retain=True).wait_for_publish(1)
        self._client.disconnect()
        self._client.loop_stop()

    def publish_changes(self) -> None:
        """After a tick of the feed: whatever changed."""
        if self._last_event is None:
            self._last_event = self._watch.log.newest  # what happened before this process is not published again
        if not self.connected:
            return
        if self._reconnected.is_set():
            self._reconnected.clear()
            self._published.clear()
        document = self._watch.document
        self._publish(self._online_topic, "1" if document is not None else "0")
        if document is None:
            return
        for kind, items in (("axis", document["axes"]), ("encoder", document["encoders"])):
            for item in items:
                self._publish(f"{self._base}/{kind}/{item['do_id']}/state", object_message(item))
        for event in self._watch.log.after(self._last_event):
            self._client.publish(f"{self._base}/event", json.dumps(asdict(event)), _QOS)
            self._last_event = event.id

    def _publish(self, topic: str, text: str) -> None:
        if self._published.get(topic) != text:
            self._published[topic] = text
            self._client.publish(topic, text, _QOS, retain=True)

    def _connected(
        self, _client: Client, _data: object, _flags: ConnectFlags, code: ReasonCode, _properties: Properties | None
    ) -> None:
        """On paho's thread."""
        if code.is_failure:
            log.warning("MQTT: %s:%d refuses: %s", self._config.host, self._config.port, code)
        else:
            log.info("MQTT: connected to %s:%d", self._config.host, self._config.port)
            self._reconnected.set()
            self._ready.set()
