"""The configuration as a file: read, with errors that name line and key, and written again."""

from __future__ import annotations

import re
from collections.abc import Sequence
from fractions import Fraction
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Final, TypeVar

from pydantic import ValidationError

from pdgw.base.validation import Problem, problems
from pdgw.gateway.axis.telegrams import (
    DSC_TELEGRAM_NUMBERS,
    POSITIONER_TELEGRAM_NUMBERS,
    SECOND_SENSOR_NUMBERS,
    SPEED_TELEGRAM_NUMBERS,
)
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.configuration.axis_config import AxisConfig
from pdgw.gateway.configuration.config import GatewayConfig, Item
from pdgw.gateway.configuration.defaults import SIMULATED_BLOCKS, SIMULATED_ENCODER_TELEGRAM, SIMULATED_KEYS
from pdgw.gateway.configuration.devices import EncoderConfig
from pdgw.gateway.configuration.environment import Surroundings
from pdgw.gateway.configuration.toml_file import parse_toml, problem_text, read_text, toml_text
from pdgw.gateway.configuration.web import MqttConfig, WebConfig

SIMULATED_WATCHDOG_FACTOR = 250
"""Cycles without a frame until the PLC is lost, where nothing real moves: a busy laptop holds a program up for some 0.1 s."""

_SIMULATED_TIMES = {"heartbeat_ms": 2000, "sdo_timeout_ms": 5000}
"""For the same reason: a device that has not got the processor for seconds is not lost. A start waits for a heartbeat."""

_SIMULATED_JOG = {"jog_speeds_rpm": (-150, 150)}


def simulated(
    numbers: Sequence[int], encoders: int = 0, encoder_number: int = SIMULATED_ENCODER_TELEGRAM
) -> GatewayConfig:
    """The configuration of ``pdgw run --simulate``: simulated drives and encoders on a virtual bus, 4 ms.

    ``numbers``: the telegram of each axis. The encoders are on the shafts of the axes in order. GatewayError for an
    impossible request.
    """
    document = {
        "can": {"interface": "virtual", "channel": "pdgw"},
        "transport": {"watchdog_factor": SIMULATED_WATCHDOG_FACTOR},
        "axis": [
            {"do_id": n, "node_id": n, "telegram": number, "simulate": True, "tpdo_event_ms": 500}
            | _SIMULATED_TIMES
            | (
                {"positioner": SIMULATED_KEYS, "block": SIMULATED_BLOCKS}
                if number in POSITIONER_TELEGRAM_NUMBERS
                else {}
            )
            | (_SIMULATED_JOG if number in SPEED_TELEGRAM_NUMBERS else {})
            | ({"dsc": "position", "following_window": 4096} if number in DSC_TELEGRAM_NUMBERS else {})
            | ({"g2": "drive"} if number in SECOND_SENSOR_NUMBERS else {})
            for n, number in enumerate(numbers, 1)
        ],
        "encoder": [
            {
                "do_id": len(numbers) + n,
                "node_id": len(numbers) + n,
                "telegram": encoder_number,
                "simulate": True,
                "motion": f"shaft={(n - 1) % len(numbers) + 1}",
            }
            | _SIMULATED_TIMES
            for n in range(1, encoders + 1)
        ],
    }
    try:
        return GatewayConfig.model_validate(document)
    except ValidationError as error:
        messages = dict.fromkeys(problem.text for problem in problems(error, GatewayConfig))
        raise GatewayError("\n".join(messages)) from error


FileSection = TypeVar("FileSection", WebConfig, MqttConfig)
_SDO_INTERVAL: Final = "0.9.0: the plan of the bus leaves room for SDOs; delete the key"
_JOG: Final = "0.9.0: write jog_speeds_rpm = [{jog_1_speed_rpm|0}, {jog_2_speed_rpm|0}]"
_JOG_DISTANCES: Final = "0.9.0: write jog_distances = [{jog_1_distance|0}, {jog_2_distance|0}]"
_JOG_VELOCITIES: Final = "0.9.0: write jog_velocities = [{jog_1_velocity|-300}, {jog_2_velocity|300}]"
_KEEP: Final = "0.9.0: 20 files of 10 s before and 5 s after an event are kept; pdgw trace watch has options for others"
_REMOVED: Final = MappingProxyType(
    {
        "axis.jog_1_speed_rpm": _JOG,
        "axis.jog_2_speed_rpm": _JOG,
        "axis.positioner.jog_1_distance": _JOG_DISTANCES,
        "axis.positioner.jog_2_distance": _JOG_DISTANCES,
        "axis.positioner.jog_1_velocity": _JOG_VELOCITIES,
        "axis.positioner.jog_2_velocity": _JOG_VELOCITIES,
        "axis.positioner.modulo_correction": "0.9.0: modulo_range alone makes a rotary axis; delete both for a linear axis",
        "axis.sdo_interval_ms": _SDO_INTERVAL,
        "axis.sync_jitter_us": "0.9.0: jitter of SYNC does not change the limit of KPC; delete the key",
        "axis.xerr_sign": "0.9.0: a positive XERR moves forward; delete the key, the PLC sends -XERR where it was -1",
        "axis.tpdo_inhibit_us": "0.9.0: a drive sends one TPDO in each cycle of the PLC; delete the key",
        "encoder.sdo_interval_ms": _SDO_INTERVAL,
        "mqtt.ca_file": "0.9.0: write tls = {ca_file|true}",
        "realtime": "0.9.0: set CPUSchedulingPolicy=, CPUSchedulingPriority=, CPUAffinity= and MemorySwapMax= in the systemd "
        "unit (realtime.conf), or start the gateway with chrt and taskset; delete the table",
        "trace.keep_before_s": _KEEP,
        "trace.keep_after_s": _KEEP,
        "trace.keep_directory": "0.9.0: the files are in traces/ of the state directory; pdgw trace watch --to has another",
        "trace.keep_files": _KEEP,
        "transport.age_limit_ms": "0.9.0: it is twice the watchdog time; delete the key, raise watchdog_factor if it was longer",
        "transport.ar_uuid": "0.9.0: the parameter channel has no application relationship; delete the key",
        "transport.parameter_timeout_ms": "0.9.0: it is 2 s, or the longest sdo_timeout_ms above it; delete the key",
        "transport.switchover_ms": "0.9.0: system redundancy (S2) is not supported; delete the key, connect one controller",
        "web.tls_key": "0.9.0: tls_cert is one PEM file with the certificate and its key",
    }
)
"""Keys of earlier versions: the version without them and the reason, with the user's values in the new key."""
_MEANT: Final = {
    "transport.device_name": "station_name",
    "transport.name_of_station": "station_name",
    "transport.profinet_device_name": "station_name",
    "transport.ip_address": "ip",
    "transport.subnet_mask": 'ip with its prefix length, such as "192.168.0.2/24"',
    "transport.netmask": 'ip with its prefix length, such as "192.168.0.2/24"',
    "transport.default_gateway": "router",
    "transport.gateway": "router",
    "transport.router_address": "router",
    "transport.update_time": "cycle_time_ms",
    "transport.update_time_ms": "cycle_time_ms",
    "transport.send_clock": "cycle_time_ms",
    "transport.watchdog_time": "watchdog_factor, a number of cycles",
    "transport.watchdog_time_ms": "watchdog_factor, a number of cycles",
    "transport.plc": "peer, the address of the PLC",
    "axis.slave_id": "node_id",
    "axis.invert": "polarity 607Eh, an object of the drive: write it with the drive's tool",
    "axis.polarity": "polarity 607Eh, an object of the drive: write it with the drive's tool",
    "web.port": 'listen with its port, such as "127.0.0.1:8420"',
}
"""Other words for a key: those of engineering tools and of other programs."""
HINTS: Final = MappingProxyType(
    {key: f"was removed in {reason}" for key, reason in _REMOVED.items()}
    | {key: f"unknown key; did you mean {meant}?" for key, meant in _MEANT.items()}
)
_PERCENT = "standstill_window_percent"

_SECRET = re.compile(r'^(\s*"?[\w-]*(?:pass|secret|token|key|user)[\w-]*"?\s*=\s*).*$', re.IGNORECASE | re.MULTILINE)
"""Keys of a python-can interface or of ours that may contain secrets."""
_COMMUNITY = re.compile(r"^snmp_\w*community\s*=.*\n", re.MULTILINE)
"""Left out as a whole: they must differ."""


def load_config(file: str | PathLike[str]) -> GatewayConfig:
    """Read and validate a file; GatewayError has one line for each thing that is wrong."""
    path = Path(file)
    text = read_text(path)
    config = parse_config(text, str(path), path.parent)
    axes = tuple(_resolved(axis, path) for axis in config.axis)
    encoders = tuple(_resolved(encoder, path) for encoder in config.encoder)
    sections: tuple[tuple[str, Sequence[AxisConfig | EncoderConfig]], ...] = (("axis", axes), ("encoder", encoders))
    missing = [
        problem_text(Problem((section, number, key), repr(str(file)), "not a file"), text, str(path))
        for section, items in sections
        for number, item in enumerate(items)
        for key, file in (("dcf", item.dcf), ("eds", None if item.eds == item.dcf else item.eds))
        if file is not None and not file.is_file()
    ]
    if missing:
        raise GatewayError("\n".join(missing))
    config = config.model_copy(update={"store": path.parent / config.store}) if config.store else config.of_file(path)
    web = _files_resolved(config.web, path)
    mqtt = None if config.mqtt is None else _files_resolved(config.mqtt, path)
    update = {"axis": axes, "encoder": encoders, "web": web, "mqtt": mqtt}
    return config.model_copy(update=update)


def _resolved(item: Item, path: Path) -> Item:
    """Relative paths are meant from where the configuration is."""
    files = {"eds": item.eds, "dcf": item.dcf}
    return item.model_copy(update={key: path.parent / file for key, file in files.items() if file is not None})


def _files_resolved(section: FileSection, path: Path) -> FileSection:
    """As ``_resolved``, for every file of a section; the program that needs a file checks whether it exists, with its rights."""
    files = {name: path.parent / value for name, value in section if isinstance(value, Path)}
    return section.model_copy(update=files)


def parse_config(text: str, name: str = "configuration", folder: Path = Path()) -> GatewayConfig:
    """Validate configuration text; see ``load_config``. Drive families with a relative path are in ``folder``."""
    return parse_toml(GatewayConfig, text, name, HINTS, Surroundings(folder))


def config_text(config: GatewayConfig) -> str:
    """The keys that differ from the defaults, and the format version, as TOML."""
    document = {"version": config.version} | config.model_dump(exclude_defaults=True)
    for item in document.get("axis", ()):
        if _PERCENT in item:
            item[_PERCENT] = float(Fraction(item[_PERCENT]) * 100)  # stored as a fraction, written as percent
    return toml_text(document)


def public_config(config: GatewayConfig) -> str:
    """The configuration as TOML, what may be a secret left out."""
    return _SECRET.sub(r'\1"..."', _COMMUNITY.sub("", config_text(config)))
