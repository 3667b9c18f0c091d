"""The commented example of a configuration, and the one of a simulation."""

from __future__ import annotations

from collections.abc import Sequence

from pydantic import ValidationError

from pdgw.ds301.load import DEFAULT_BITRATE
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
from pdgw.gateway.configuration.defaults import USUAL_CYCLE_MS, WATCHDOG_FACTOR
from pdgw.gateway.configuration.positioner import EXAMPLE as POSITIONER_EXAMPLE
from pdgw.gateway.configuration.positioner import SIMULATED, SIMULATED_BLOCKS
from pdgw.gateway.configuration.web import WebConfig
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

# name = "press 3"           # of the gateway, on status, page, MQTT topics and in the log; axes and encoders have a name too

# store = "parameters.json"  # what the PLC changed and a restart keeps (P922, P925, P927, I&M); without it
#                            # ~/.local/state/pdgw/ (XDG_STATE_HOME, or systemd's StateDirectory), by this file's name

[can]
interface = "socketcan"      # any python-can interface
channel = "can0"
bitrate = {DEFAULT_BITRATE}
# Further keys go to the interface unchanged. For several buses use [[can]] tables with a name each,
# and can = "name" in the axes.

[transport]
type = "udp"
listen = "127.0.0.1"         # address of this machine towards the PLC
cyclic_port = {CYCLIC_PORT}
acyclic_port = {ACYCLIC_PORT}
cycle_time_ms = {USUAL_CYCLE_MS}            # 0.25 to 512
watchdog_factor = {WATCHDOG_FACTOR}          # the PLC is lost after this many cycles without a frame
# parameter_timeout_ms = 2000  # a parameter request is answered within this time
# ar_uuid = "00000000-0000-0000-0000-000000000000"   # of the static application relationship
# station_name = "pdgw"      # P61000; of "profinet" until DCP gives another name, "" for none until then
# peer = "192.168.0.10"      # only this PLC; without it the first sender, which only listen = "127.0.0.1" allows
# direct = false             # true: nothing but cables and switches to the PLC, no frame comes late (docs/plc.md)
# A PROFINET IO device on Ethernet instead (docs/profinet.md):
# type = "profinet"
# interface = "eth1"
# ip = "192.168.0.2/24"      # without it the controller gives one by DCP
# router = "192.168.0.1"
# snmp_community = "public"  # of "profinet": a read-only SNMP agent; none without it
# snmp_write_community = "secret"  # who sends it may write sysContact, sysName and sysLocation
# switchover_ms = 300        # of "profinet": two redundant controllers; the axes may go on for so long without one
# vendor_id = {identity.VENDOR_ID}          # of your PI membership; {identity.VENDOR_ID} is nobody's
# device_id = {identity.DEVICE_ID}

# [parameters]
# write_from = ["192.168.0.10", "192.168.0.64/28"]   # who may write parameters; without it everybody on this machine, or nobody

# [realtime]                 # Linux; what is not granted is told, and the gateway runs without
# priority = 50              # SCHED_FIFO, 1 to 99; 40 where it is granted without this key, 0 for the usual scheduling
# cpu = [1]                  # processors to run on
# lock_memory = true

# [trace]                    # flight recorder, see pdgw trace
# enabled = true             # where there is a run directory
# directory = "/run/pdgw"    # in RAM; without it systemd's RuntimeDirectory, XDG_RUNTIME_DIR or /dev/shm
# seconds = 120              # that long back
# megabytes = 32             # of memory at most
# keep = ["fault", "stop"]   # a file of what was before and after each, as pdgw trace save writes it
# keep_directory = "traces"  # without it in the state directory
# keep_before_s = 10
# keep_after_s = 5
# keep_files = 20            # the oldest go

# [web]                      # the page of `pdgw web`, which shows everything and changes nothing (docs/web.md)
# listen = "{WebConfig().listen}"  # beyond this machine only with token_file
# token_file = "web.token"   # its text opens the page
# hosts = ["gateway.plant"]  # names by which browsers reach it, beside its address
# tls_cert = "web.pem"
# tls_key = "web.key"

# [mqtt]                     # `pdgw web` tells a broker what the axes do, and takes nothing from it
# host = "broker.plant"
# port = 1883
# topic = "pdgw"             # before the gateway's name
# username = "gateway"
# password_file = "mqtt.password"
# tls = true
# ca_file = "ca.pem"

[[axis]]
do_id = 1                    # DO-ID of the parameter channel, 1 to 254
node_id = 1                  # CANopen node, 1 to 126
telegram = 1                 # one of {_listed(DRIVE_TELEGRAM_NUMBERS)}
# eds = "drive.eds"          # EDS or DCF of the drive; without it the drive itself is asked which objects it has
on_plc_loss = "quick-stop"   # "ramp", "quick-stop" or "coast"
setpoint_enable = "profidrive"  # STW1 bit 4 or 6 = 0: speed 0; bit 5 = 0: freezes the ramp. "hold": 60FFh stays in all three
control_lost = "stop"        # STW1.10 = 0 in operation: "stop" as OFF1, or "hold" the last words; OFF1-3 act in any case
modulo_axis = false          # telegram 9: turntable
simulate = false             # true: a simulated drive instead of the one on the bus
# intermediate_stop_reached = false  # true: ZSW1.10 = 1 also at standstill in an intermediate stop (telegrams 7, 9, 110 to 112)
# ramp_stop_resume = false   # true: ON during an OFF1 ramp resumes operation
# standstill_window_percent = 1
# stop_time_ms = 10000       # longest way from 100 % speed to standstill; one that takes twice as long counts as deaf
# heartbeat_ms = 100
# tpdo_event_ms = 50
# tpdo_inhibit_us = 4000     # without it: the cycle time
# sdo_timeout_ms = 500
# sdo_interval_ms = 4        # the parameter channel pauses between two SDOs
# sync = false               # TPDOs on SYNC instead of event-driven; telegrams {_listed(central)}: set-points too
# allow_unguarded = false    # true: operate a drive that nothing stops when the gateway dies
# g1 = 3                     # telegrams with G1: DO-ID of the encoder that it is, without it the drive's own position
# g2 = 4                     # telegrams with G2: DO-ID, or "drive": its second encoder (60E4h); without it error 0F01h
# family = "engel"           # the overlay of the drive, without it by its identity
# What the drive does not tell about its units; pdgw config check --bus shows what it does tell (docs/units.md).
# rated_speed_rpm = 3000     # 100 % of NSOLL in rpm of the motor, without it Max Motor Speed 6080h
# velocity_unit = "rpm"      # of 60FFh: such as "0.1 rpm", "counts/s", "mm/s"
# ignored_unit_objects = ["60A9h"]     # objects of the drive whose units are wrong
# position_unit = "0.01 mm"  # of 607Ah, or:
# counts_per_revolution = 4096         # position units in one revolution of the motor
# acceleration_unit = "rpm/s"          # of 6083h, needed with:
# rated_acceleration_rpm_s = 10000     # 100 % of MDI_ACC and MDI_DEC, without it Max Acceleration 60C5h
# gear = "10/1"              # revolutions of the motor to those of the shaft behind the gear, without it 6091h

# jog_1_speed_rpm = -100     # speed telegrams: STW1.8 and .9 with .4 to .6 = 0; without both keys they do nothing
# jog_2_speed_rpm = 100
# dsc = "position"           # telegrams {_listed(DSC_TELEGRAM_NUMBERS)}: "position" (mode 8) or "speed" (mode 9): docs/motion.md
# following_window = 4096    # position units within which DSC may start, needed with dsc
# dsc_delay_cycles = 1       # age of the position the PLC answers
# xerr_sign = 1              # -1: a positive XERR moves backward
# sync_jitter_us = 0         # added to the dead time that limits KPC; pdgw status shows the jitter
# Telegrams {_listed(POSITIONER_TELEGRAM_NUMBERS)} need a positioner: LU, 1000 LU/min, 1000 LU/s2 (docs/motion.md).
{POSITIONER_EXAMPLE}
# Encoders follow the axes in the frame. Several channels of a multi-sensor device are tables of their own.
# [[encoder]]
# do_id = 3
# node_id = 10
# telegram = 83              # one of {_listed(ENCODER_TELEGRAM_NUMBERS)}
# model = "rotary"           # "rotary", "linear" or "multi-sensor"; eds = "encoder.eds" for another data sheet
# channel = 1                # of a multi-sensor device
# reference_speed = 3000     # 100 % of NIST: rpm, of a linear encoder mm/s
# tpdo_event_ms = 4          # cyclic timer; without it the cycle time
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
