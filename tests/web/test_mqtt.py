"""What a real broker gets: states on change, events, the last will."""

from __future__ import annotations

import json
import shutil
import socket
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from paho.mqtt.client import Client, MQTTMessageInfo
from paho.mqtt.enums import CallbackAPIVersion, MQTTErrorCode

from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.web import MqttConfig
from pdgw.tools.web.mqtt import MESSAGE_MAX, Publisher, made_client, object_message, topic_name
from pdgw.tools.web.status.watch import Watch
from tests.support.buses import PATIENCE_S
from tests.support.gateways.daemon import axis, configuration, running
from tests.support.gateways.daemon import until as until_true
from tests.support.page import ShownGateway, look, until
from tests.support.processes import free_tcp_port

BROKER = shutil.which("mosquitto") or "/usr/sbin/mosquitto"
needs_broker = pytest.mark.skipif(
    not Path(BROKER).exists(), reason="no MQTT broker on this machine (apt-get install mosquitto)"
)
ENCODER = "[[encoder]]\ndo_id = 2\nnode_id = 20\ntelegram = 83\nsimulate = true\n"


@contextmanager
def broker(port: int) -> Iterator[None]:
    """A broker of its own; returns when it accepts."""
    with subprocess.Popen([BROKER, "-p", str(port)], stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL) as process:
        try:
            until(lambda: accepts(port), "the broker")
            yield
        finally:
            process.terminate()


def accepts(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


class Subscriber:
    """Hears everything below a topic: the last text of each topic, and all events."""

    def __init__(self, port: int) -> None:
        self.texts: dict[str, str] = {}
        self.events: list[dict[str, Any]] = []
        self.online: list[str] = []
        self.states = 0
        self._subscribed = threading.Event()
        self.client = Client(CallbackAPIVersion.VERSION2, client_id="test")
        self.client.on_message = self._take
        self.client.on_subscribe = lambda *_: self._subscribed.set()
        self.client.on_connect = lambda client, *_: client.subscribe("pdgw/#", 1)
        self.client.connect("127.0.0.1", port)
        self.client.loop_start()
        assert self._subscribed.wait(PATIENCE_S)

    def _take(self, _client: Client, _data: object, message: Any) -> None:
        text = message.payload.decode()
        if message.topic.endswith("/event"):
            self.events.append(json.loads(text))
        if message.topic.endswith("/online"):
            self.online.append(text)
        self.states += message.topic.endswith("/state")
        self.texts[message.topic] = text

    def close(self) -> None:
        self.client.disconnect()
        self.client.loop_stop()


def looked(watch: Watch, publisher: Publisher) -> None:
    """Query the gateway once and publish the result."""
    look(watch)
    publisher.publish_changes()


def with_broker(config: GatewayConfig, port: int) -> GatewayConfig:
    return config.model_copy(update={"mqtt": MqttConfig(host="127.0.0.1", port=port), "name": "line-3"})


def vanish_at_the_good_bye(publisher: Publisher) -> None:
    """Close the connection silently after the publisher has seen that it is open, before its next message."""
    client = publisher._client
    client.reconnect_delay_set(int(PATIENCE_S), int(PATIENCE_S))
    said = client.publish

    def publish(*message: Any, **how: Any) -> MQTTMessageInfo:
        connection = client.socket()
        assert connection is not None
        connection.shutdown(socket.SHUT_RDWR)
        until(lambda: not client.is_connected(), "that paho sees it")
        return said(*message, **how)

    client.publish = publish  # type: ignore[method-assign]


@pytest.mark.e2e
@needs_broker
def test_states_on_change_events_and_the_last_will() -> None:
    port = free_tcp_port()
    gateway = ShownGateway()
    with broker(port), running(with_broker(configuration(axis(1) + ENCODER), port)) as daemon:
        gateway.show(daemon)
        watch = Watch(daemon.config, gateway)
        assert watch.config.mqtt is not None
        publisher = Publisher(watch.config.mqtt, watch)
        publisher.start()
        heard = Subscriber(port)
        until(lambda: publisher.connected, "the publisher")
        looked(watch, publisher)
        until(lambda: len(heard.texts) >= 3, "axis, encoder and online")
        assert heard.texts["pdgw/line-3/online"] == "1"
        state = json.loads(heard.texts["pdgw/line-3/axis/1/state"])
        assert (state["state"], state["reason_id"], state["fault"]) == ("Starting", "NODE_CONFIGURING", None)
        assert "pdgw/line-3/encoder/2/state" in heard.texts

        told = heard.states
        looked(watch, publisher)  # nothing changed
        until_true(daemon, lambda: all(item.client.generation for item in daemon.objects), "nodes online")
        gateway.show(daemon)
        looked(watch, publisher)
        until(lambda: json.loads(heard.texts["pdgw/line-3/axis/1/state"])["drive"] == "online", "the new state")
        until(lambda: heard.states >= told + 2, "axis and encoder")
        assert heard.states == told + 2, "once each"
        until(lambda: any("online" in event["text"] for event in heard.events), "the event")

        gateway.failure = "hangs"
        looked(watch, publisher)
        until(lambda: heard.texts["pdgw/line-3/online"] == "0", "that the gateway does not answer")
        gateway.failure = ""
        looked(watch, publisher)
        until(lambda: heard.texts["pdgw/line-3/online"] == "1", "that it answers again")
        vanish_at_the_good_bye(publisher)
        publisher.stop()
        until(lambda: heard.online.count("0") == 2, "the last will of who vanished")
        heard.close()


def test_mqtt_message_has_no_permanently_changing_values() -> None:
    gateway = ShownGateway()
    with running(configuration(axis(1))) as daemon:
        gateway.show(daemon)
        message = json.loads(object_message(gateway.document["axes"][0]))
    assert set(message) == {
        "name",
        "state",
        "state_id",
        "sentence",
        "reason",
        "reason_id",
        "remedy",
        "drive",
        "telegram",
        "fault",
    }


def test_two_default_gateways_on_one_broker_have_client_ids_and_topics_of_their_own() -> None:
    gateway = ShownGateway()
    config = with_broker(configuration(axis(1)), 1).model_copy(update={"name": None})
    other = config.model_copy(update={"transport": config.transport.model_copy(update={"status_port": 35000})})
    assert config.mqtt is not None
    ids = {bytes(Publisher(config.mqtt, Watch(config, gateway))._client._client_id) for _ in range(2)}
    assert len(ids) == 2
    assert topic_name(config) != topic_name(other)
    assert topic_name(config).startswith(topic_name(other).rpartition("-")[0])


def test_unusable_mqtt_files_are_reported(tmp_path: Path) -> None:
    with pytest.raises(GatewayError, match="password_file"):
        made_client(MqttConfig(host="b", username="u", password_file=tmp_path / "none"), "x")
    with pytest.raises(GatewayError, match="tls"):
        made_client(MqttConfig(host="b", tls=tmp_path / "none"), "x")


def test_a_message_of_256_megabytes_ends_the_connection(caplog: pytest.LogCaptureFixture) -> None:
    connack, length = b"\x20\x02\x00\x00", b"\xff\xff\xff\x7f"
    with socket.create_server(("127.0.0.1", 0)) as port:
        client = made_client(MqttConfig(host="127.0.0.1"), "test")
        client.connect(*port.getsockname())
        with port.accept()[0] as server:
            server.sendall(connack + b"\x30" + length + bytes(MESSAGE_MAX))
            assert client.loop_read() == MQTTErrorCode.MQTT_ERR_SUCCESS, "the broker accepts"
            while (result := client.loop_read()) == MQTTErrorCode.MQTT_ERR_SUCCESS:
                pass
    assert result == MQTTErrorCode.MQTT_ERR_CONN_LOST
    assert not client._in_packet["packet"]
    assert f"268435455 bytes from the broker rejected, allowed: {MESSAGE_MAX}" in caplog.text
