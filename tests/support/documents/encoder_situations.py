"""Situations in which an encoder, or the way the PLC's program uses it, is the cause."""

from __future__ import annotations

from pdgw.gateway.daemon.daemon import Daemon
from pdgw.tools.output.status_text import Health
from tests.support.documents.device_situations import DeviceSituation
from tests.support.documents.situations import both, run_out, send
from tests.support.gateways.daemon import Plc, encoder_of, switch_off

_ENCODER = "[[encoder]]\ndo_id = 2\nnode_id = 20\ntelegram = 81\nsimulate = true\n"
_VENDOR = 0x406
"""Vendor-ID of the simulated encoder."""


def _set_vendor(daemon: Daemon, vendor: int) -> None:
    encoder_of(daemon).node.values[0x1018, 1] = vendor


def _built_in_encoder(plc: Plc, daemon: Daemon) -> None:
    """The data sheet is that of the device."""
    _set_vendor(daemon, _VENDOR)
    plc.endpoint.set(0, {"STW2_ENC": 0x0400})
    plc.until(lambda: daemon.encoders[0].good, "online")


def _sensor_error(plc: Plc, daemon: Daemon) -> None:
    _built_in_encoder(plc, daemon)
    plc.endpoint.set(0, {"STW2_ENC": 0x0400, "G1_STW": 0x0001 | 1 << 4})
    plc.exchange()


def _alarm(_: Plc, daemon: Daemon) -> None:
    encoder_of(daemon).inject("position-error")


def _clear_alarm(_: Plc, daemon: Daemon) -> None:
    encoder_of(daemon).clear("position-error")


def _power_off(plc: Plc, daemon: Daemon) -> None:
    switch_off(daemon, encoder_of(daemon))
    plc.until(lambda: not daemon.encoders[0].good, "lost")
    run_out(plc)


def _power_on(plc: Plc, daemon: Daemon) -> None:
    encoder_of(daemon).node.restart()
    plc.until(lambda: daemon.encoders[0].good, "found again")
    run_out(plc)


_PULSE = send({"STW2_ENC": 0x0400, "G1_STW": 0}, {"G1_STW": 0x8000}, {"G1_STW": 0})
_ACKNOWLEDGE = send({"STW2_ENC": 0x0400}, {"STW2_ENC": 0x0480}, {"STW2_ENC": 0x0400})
_SOUND_SENSOR = both(_clear_alarm, _PULSE, _ACKNOWLEDGE)
ENCODER_SITUATIONS: dict[str, DeviceSituation] = {
    "the encoder is of another manufacturer, and the configuration has no EDS": DeviceSituation(
        operates=False,
        tables=_ENCODER,
        spoil=lambda daemon: _set_vendor(daemon, 0xABCE),
        says=("rejected", "0000ABCEh", "as in the built-in data sheet", "set the key eds"),
        lacks=("as in the EDS", "check power", "config check"),
        cure=_built_in_encoder,
    ),
    "the PLC's program sends a sensor command that the encoder does not have": DeviceSituation(
        tables=_ENCODER,
        operates=False,
        begin=_sensor_error,
        says=("Fault", "sensor error 0F01h, G1_STW has a command that the sensor does not have"),
        cure=_PULSE,
    ),
    "the PLC acknowledges an encoder without control": DeviceSituation(
        tables=_ENCODER,
        operates=False,
        begin=both(send({"STW2_ENC": 0x0400}), _alarm, send({"STW2_ENC": 0}, {"G1_STW": 0x8000})),
        says=("Fault", "sensor error 0001h", "G1_STW.15 has no effect while STW2_ENC.10 = 0"),
        cure=_SOUND_SENSOR,
    ),
    "the PLC holds the acknowledge of an encoder": DeviceSituation(
        tables=_ENCODER,
        operates=False,
        begin=both(send({"STW2_ENC": 0x0400, "G1_STW": 0x8000}), _alarm),
        says=("Fault", "sensor error 0001h", "it needs an edge, set G1_STW.15 to 0 and then to 1"),
        lacks=("cause is still there",),
        cure=_SOUND_SENSOR,
    ),
    "the PLC acknowledges an encoder while the cause is there": DeviceSituation(
        tables=_ENCODER,
        operates=False,
        begin=both(send({"STW2_ENC": 0x0400}), _alarm, send({"G1_STW": 0}, {"G1_STW": 0x8000}, {"G1_STW": 0})),
        says=(
            "Fault",
            "sensor error 0001h",
            "the cause is still there: remove it, then set G1_STW.15 to 0 and then to 1",
        ),
        cure=_SOUND_SENSOR,
    ),
    "the PLC acknowledges an encoder and does not end it": DeviceSituation(
        tables=_ENCODER,
        operates=False,
        begin=both(send({"STW2_ENC": 0x0400}), _alarm, send({"G1_STW": 0}), _clear_alarm, send({"G1_STW": 0x8000})),
        says=("Fault", "sensor error 0001h", "set G1_STW.15 to 0: this ends the acknowledge"),
        cure=both(send({"G1_STW": 0}), _ACKNOWLEDGE),
    ),
    "the PLC acknowledges the sensor of an encoder, and not its fault": DeviceSituation(
        tables=_ENCODER,
        operates=False,
        begin=both(send({"STW2_ENC": 0x0400}), _alarm, send({"G1_STW": 0}), _clear_alarm, _PULSE),
        says=("Fault: EMCY 1000h generic error, since ", "then acknowledge (STW2_ENC.7)"),
        lacks=("G1_STW",),
        cure=_ACKNOWLEDGE,
    ),
    "the PLC acknowledges the fault of an encoder while the cause is there": DeviceSituation(
        tables=_ENCODER,
        operates=False,
        begin=both(send({"STW2_ENC": 0x0400, "G1_STW": 0x4000}), _alarm, send({}), _ACKNOWLEDGE),
        says=(
            "Fault: EMCY 1000h generic error, since ",
            "the cause is still there",
            "set STW2_ENC.7 to 0 and then to 1",
        ),
        cure=both(_clear_alarm, _PULSE, _ACKNOWLEDGE),
    ),
    "the encoder has no power": DeviceSituation(
        tables=_ENCODER,
        operates=False,
        begin=both(_built_in_encoder, _power_off),
        says=("Not on the bus: node 20", "silent: neither heartbeats nor TPDOs"),
        lacks=("TPDO1", "being configured"),
        cure=both(_power_on, _PULSE, _ACKNOWLEDGE),
    ),
    "the encoder had no power for a moment, twice": DeviceSituation(
        tables=_ENCODER,
        operates=False,
        begin=both(_built_in_encoder, _power_off, _power_on, _power_off, _power_on),
        says=(
            "Fault: sensor error 0001h, the position is wrong or missing: node lost: silent",
            ", since ",
            "(2 times)",
            "Check plug, cable and supply of the node; then acknowledge (G1_STW.15)",
        ),
        cure=both(_PULSE, _ACKNOWLEDGE),
    ),
    "the encoder had no power, and the PLC acknowledges its fault alone": DeviceSituation(
        tables=_ENCODER,
        operates=False,
        begin=both(_built_in_encoder, _power_off, _power_on, _ACKNOWLEDGE),
        says=("Fault: sensor error 0001h", "node lost: silent", "Check plug, cable", "then acknowledge (G1_STW.15)"),
        cure=_PULSE,
    ),
    "the PLC's program parks the sensor": DeviceSituation(
        tables=_ENCODER,
        operates=False,
        begin=send({"STW2_ENC": 0x0400, "G1_STW": 0x4000}),
        says=("Off: G1_STW.14 = 1: sensor is parked",),
        health=Health.OK,
        cure=send({"G1_STW": 0}),
    ),
}
"""What a technician finds at an encoder, over both links."""
