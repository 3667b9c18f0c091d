"""The commented example of a configuration, and the one of a simulation."""

from __future__ import annotations

from collections.abc import Sequence

from pydantic import ValidationError

from pdgw.ds301.bus.load import DEFAULT_BITRATE
from pdgw.explain import problems
from pdgw.gateway import identity
from pdgw.gateway.axis.telegrams import (
    CENTRAL_TELEGRAM_NUMBERS,
    DRIVE_TELEGRAM_NUMBERS,
    DSC_TELEGRAM_NUMBERS,
    ENCODER_TELEGRAM_NUMBERS,
    POSITIONER_TELEGRAM_NUMBERS,
    SECOND_SENSOR_NUMBERS,
    SPEED_TELEGRAM_NUMBERS,
)
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.tables.defaults import USUAL_CYCLE_MS, WATCHDOG_FACTOR
from pdgw.gateway.configuration.tables.positioner import EXAMPLE as POSITIONER_EXAMPLE
from pdgw.gateway.configuration.tables.positioner import SIMULATED, SIMULATED_BLOCKS
from pdgw.gateway.configuration.tables.web import WebConfig
from pdgw.gateway.errors import GatewayError
from pdgw.profidrive.frame import CYCLIC_PORT
from pdgw.profinet.rpc.dcerpc import ACYCLIC_PORT


def _listed(numbers: Sequence[int]) -> str:
    return ", ".join(map(str, numbers))


def example() -> str:
    """A commented configuration that is itself valid."""
    central = [number for number in CENTRAL_TELEGRAM_NUMBERS if number not in DSC_TELEGRAM_NUMBERS]
    return f"""\
# Configuration of the PROFIdrive-to-CANopen gateway. Times in milliseconds.

# name = "press 3"           # name of the gateway in status, page, MQTT topics and log; axes and encoders can have a name too

# store = "parameters.json"  # parameters that survive a restart (P922, P925, P927, I&M); default:
#                            # ~/.local/state/pdgw/ (XDG_STATE_HOME, or systemd's StateDirectory), by this file's name

[can]
interface = "socketcan"      # any python-can interface
channel = "can0"
bitrate = {DEFAULT_BITRATE}
# python-can receives further keys unchanged. For several buses use [[can]] tables with a name each,
# and can = "name" in the axes.

[transport]
type = "udp"
listen = "127.0.0.1"         # address of this machine towards the PLC
cyclic_port = {CYCLIC_PORT}
acyclic_port = {ACYCLIC_PORT}
cycle_time_ms = {USUAL_CYCLE_MS}            # 0.25 to 512
watchdog_factor = {WATCHDOG_FACTOR}          # number of cycles without a frame after which the PLC is lost
# parameter_timeout_ms = 2000  # longest time until a parameter request is answered
# ar_uuid = "00000000-0000-0000-0000-000000000000"   # of the static application relationship
# peer = "192.168.0.10"      # accept only this PLC; without it the first sender (allowed only with listen = "127.0.0.1")
# direct = false             # true: only cables and switches connect the PLC, so that no old frame can arrive (docs/plc.md)
# A PROFINET IO device on Ethernet instead (docs/profinet.md):
# type = "profinet"
# station_name = "pdgw"      # "profinet": name until DCP sets another one, "" for none; P61000
# interface = "eth1"
# ip = "192.168.0.2/24"      # without it the controller sets the address by DCP
# router = "192.168.0.1"
# snmp_community = "public"  # "profinet": a read-only SNMP agent; without it no agent
# snmp_write_community = "secret"  # community that may write sysContact, sysName and sysLocation
# switchover_ms = 300        # "profinet": two redundant controllers; the axes may run for this time without one
# vendor_id = {identity.VENDOR_ID}          # number of your PI membership; {identity.VENDOR_ID} is not assigned
# device_id = {identity.DEVICE_ID}

# [parameters]
# write_from = ["192.168.0.10", "192.168.0.64/28"]   # addresses that may write parameters; default: this machine only, or none

# [realtime]                 # Linux; the log names a setting that is not granted, and the gateway runs without it
# priority = 50              # SCHED_FIFO, 1 to 99; default: 40 if the system grants it; 0: normal scheduling
# cpu = [1]                  # processors to run on
# lock_memory = true

# [trace]                    # flight recorder, see pdgw trace
# enabled = true             # default: true if a run directory exists
# directory = "/run/pdgw"    # in RAM; without it systemd's RuntimeDirectory, XDG_RUNTIME_DIR or /dev/shm
# seconds = 120              # length of the recording
# megabytes = 32             # limit of the memory
# keep = ["fault", "stop"]   # write a file around each fault or stop, like pdgw trace save
# keep_directory = "traces"  # default: the state directory
# keep_before_s = 10
# keep_after_s = 5
# keep_files = 20            # the oldest are deleted

# [web]                      # the read-only page of `pdgw web` (docs/web.md)
# listen = "{WebConfig().listen}"  # another address than this machine needs token_file
# token_file = "web.token"   # file with the token that opens the page
# hosts = ["gateway.plant"]  # host names of the page in browsers, in addition to its address
# tls_cert = "web.pem"
# tls_key = "web.key"

# [mqtt]                     # `pdgw web` publishes the state of the axes; it subscribes to nothing
# host = "broker.plant"
# port = 1883
# topic = "pdgw"             # prefix, before the gateway's name
# username = "gateway"
# password_file = "mqtt.password"
# tls = true
# ca_file = "ca.pem"

[[axis]]
do_id = 1                    # DO-ID of the parameter channel, 1 to 254
node_id = 1                  # CANopen node, 1 to 126
telegram = 1                 # one of {_listed(DRIVE_TELEGRAM_NUMBERS)}
# eds = "drive.eds"          # EDS or DCF of the drive; default: the gateway reads the objects from the drive
on_plc_loss = "quick-stop"   # "ramp", "quick-stop" or "coast"
setpoint_enable = "profidrive"  # STW1 bit 4 or 6 = 0: speed 0; bit 5 = 0: freezes the ramp. "hold": 60FFh stays in all three
control_lost = "stop"        # STW1.10 = 0 in operation: "stop" as OFF1, or "hold" keeps the last words; OFF1-3 always act
modulo_axis = false          # telegram 9: turntable
simulate = false             # true: a simulated drive instead of the one on the bus
# intermediate_stop_reached = false  # true: ZSW1.10 = 1 also at standstill in an intermediate stop (telegrams 7, 9, 110 to 112)
# ramp_stop_resume = false   # true: ON during an OFF1 ramp resumes operation
# standstill_window_percent = 1
# stop_time_ms = 10000       # longest time from 100 % speed to standstill; fault 125 after twice this time
# heartbeat_ms = 100
# tpdo_event_ms = 50
# tpdo_inhibit_us = 4000     # default: the cycle time
# sdo_timeout_ms = 500
# sdo_interval_ms = 4        # pause of the parameter channel between two SDOs
# sync = false               # TPDOs on SYNC instead of event-driven; telegrams {_listed(central)}: set-points too
# allow_unguarded = false    # true: operate a drive that does not stop by itself if the gateway dies
# g1 = 3                     # telegrams with G1: DO-ID of the encoder for G1; default: the drive's own position
# g2 = 4                     # telegrams with G2: DO-ID, or "drive" for its second encoder (60E4h); without it error 0F01h
# family = "engel"           # overlay of the drive; default: selected by the identity of the drive
# Units that the drive does not report; pdgw config check --bus shows the reported ones (docs/units.md).
# rated_speed_rpm = 3000     # 100 % of NSOLL in rpm of the motor; default: Max Motor Speed 6080h
# velocity_unit = "rpm"      # unit of 60FFh, such as "0.1 rpm", "counts/s", "mm/s"
# ignored_unit_objects = ["60A9h"]     # objects of the drive whose units are wrong
# position_unit = "0.01 mm"  # of 607Ah, or:
# counts_per_revolution = 4096         # position units in one revolution of the motor
# acceleration_unit = "rpm/s"          # of 6083h, needed with:
# rated_acceleration_rpm_s = 10000     # 100 % of MDI_ACC and MDI_DEC; default: Max Acceleration 60C5h
# gear = "10/1"              # revolutions of the motor to revolutions of the output shaft; default: 6091h

# jog_1_speed_rpm = -100     # speed telegrams: STW1.8 and .9 with .4 to .6 = 0; without both keys these bits have no effect
# jog_2_speed_rpm = 100
# dsc = "position"           # telegrams {_listed(DSC_TELEGRAM_NUMBERS)}: "position" (mode 8) or "speed" (mode 9): docs/motion.md
# following_window = 4096    # largest distance at which DSC may start, in position units; dsc needs it
# dsc_delay_cycles = 1       # age of the position to which the PLC reacts
# xerr_sign = 1              # -1: a positive XERR moves backward
# sync_jitter_us = 0         # added to the dead time that limits KPC; pdgw status shows the jitter
# Telegrams {_listed(POSITIONER_TELEGRAM_NUMBERS)} need a positioner: LU, 1000 LU/min, 1000 LU/s2 (docs/motion.md).
{POSITIONER_EXAMPLE}
# Encoders follow the axes in the frame. Each channel of a multi-sensor device has its own table.
# [[encoder]]
# do_id = 3
# node_id = 10
# telegram = 83              # one of {_listed(ENCODER_TELEGRAM_NUMBERS)}
# model = "rotary"           # "rotary", "linear" or "multi-sensor"; eds = "encoder.eds" for another data sheet
# channel = 1                # of a multi-sensor device
# reference_speed = 3000     # 100 % of NIST: rpm, of a linear encoder mm/s
# tpdo_event_ms = 4          # cyclic timer; default: the cycle time
# simulate = false           # true: a simulated encoder, moved by motion = "..." (see pdgw sim encoder --help)
"""


SIMULATED_ENCODER_TELEGRAM = 83
SIMULATED_WATCHDOG_FACTOR = 250
"""Cycles without a frame until the PLC is lost, where nothing real moves: a busy laptop holds a program up for some 0.1 s."""

_SIMULATED_TIMES = {"heartbeat_ms": 2000, "sdo_timeout_ms": 5000}
"""For the same reason: a device that has not got the processor for seconds is not lost. A start waits for a heartbeat."""

_SIMULATED_JOG = {"jog_1_speed_rpm": -150, "jog_2_speed_rpm": 150}


def simulated(
    numbers: Sequence[int], encoders: int = 0, encoder_number: int = SIMULATED_ENCODER_TELEGRAM
) -> GatewayConfig:
    """The configuration of ``pdgw run --simulate``: simulated drives and encoders on a virtual bus, 4 ms.

    ``numbers``: the telegram of each axis. The encoders sit on the shafts of the axes, one after the other. GatewayError names
    what is not possible.
    """
    document = {
        "can": {"interface": "virtual", "channel": "pdgw"},
        "transport": {"watchdog_factor": SIMULATED_WATCHDOG_FACTOR},
        "axis": [
            {"do_id": n, "node_id": n, "telegram": number, "simulate": True, "tpdo_event_ms": 2000}
            | _SIMULATED_TIMES
            | ({"positioner": SIMULATED, "block": SIMULATED_BLOCKS} if number in POSITIONER_TELEGRAM_NUMBERS else {})
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
