"""The packages, and the optional part of the build: ``PDGW_COMPILED=1`` compiles the cyclic path by mypyc.

Everything else is declared in pyproject.toml. The compiled modules are the same typed sources, which stay in the wheel; without
them it is complete too.
"""

from __future__ import annotations

import os
import sys

if sys.version_info[:2] < (3, 11):  # noqa: UP036 (before tomllib, which 3.10 does not have)
    sys.exit("needs Python 3.11 or newer, this is {}.{}".format(*sys.version_info[:2]))

import tomllib
from pathlib import Path
from typing import Any

from setuptools import setup

COMPILED = (
    "ds301/bus/can_frame.py",
    "ds301/bus/listeners.py",
    "ds301/bus/network.py",
    "ds301/bus/node_checks.py",
    "ds301/bus/port.py",
    "ds301/bus/reopening.py",
    "ds301/bus/sdo_queue.py",
    "ds301/bus/sync_demand.py",
    "ds301/loop/arrivals.py",
    "ds301/loop/loop.py",
    "ds301/loop/readiness.py",
    "ds301/loop/system_loop.py",
    "ds301/loop/virtual_loop.py",
    "ds301/node/bring_up.py",
    "ds301/node/client.py",
    "ds301/node/confirmation.py",
    "ds301/node/heartbeat.py",
    "ds301/node/configuring.py",
    "ds301/node/doubles.py",
    "ds301/node/emergencies.py",
    "ds301/node/losses.py",
    "ds301/node/mapping.py",
    "ds301/node/node.py",
    "ds301/node/operation.py",
    "ds301/node/polled.py",
    "ds301/node/sdo.py",
    "ds301/pdo.py",
    "ds301/sdo_frames.py",
    "ds301/sdo_transfer.py",
    "dsp402/drive/client.py",
    "dsp402/drive/images.py",
    "dsp402/drive/mode_check.py",
    "dsp402/drive/power_off.py",
    "dsp402/drive/tpdo_check.py",
    "dsp402/drive/unit_check.py",
    "dsp402/drive/rpdos.py",
    "dsp402/drive/settings.py",
    "dsp402/pdo/layouts.py",
    "dsp402/states.py",
    "dsp402/units/unit_watch.py",
    "dsp406/diagnosis.py",
    "dsp406/encoder.py",
    "dsp406/settings.py",
    "gateway/axis/**/[!_]*.py",
    "gateway/daemon/buses.py",
    "gateway/daemon/daemon.py",
    "gateway/daemon/link_port.py",
    "gateway/daemon/pause.py",
    "gateway/daemon/shutdown.py",
    "gateway/daemon/stored_objects.py",
    "gateway/links/cyclic.py",
    "gateway/links/link.py",
    "gateway/links/losses.py",
    "gateway/links/new_frames.py",
    "gateway/links/refusals.py",
    "gateway/links/profinet/io_device.py",
    "gateway/links/profinet/pairing.py",
    "gateway/links/profinet/relationship.py",
    "gateway/links/profinet/traffic.py",
    "gateway/base/udp.py",
    "gateway/motion/[!_]*.py",
    "gateway/objects/axis.py",
    "gateway/objects/drive_object.py",
    "gateway/objects/encoder.py",
    "gateway/objects/fault_buffer.py",
    "gateway/service/cycle_times.py",
    "gateway/trace/json_values.py",
    "gateway/trace/pcapng.py",
    "gateway/trace/recorder.py",
    "gateway/trace/steps.py",
    "profidrive/frame.py",
    "profidrive/sign_of_life.py",
    "profidrive/normalisation.py",
    "profinet/alarms/diagnosis.py",
    "profinet/connection/application_relation.py",
    "profinet/connection/cmdev.py",
    "profinet/connection/cpm.py",
    "profinet/connection/ppm.py",
    "profinet/device.py",
    "profinet/ethernet.py",
)
"""Patterns of what every cycle runs through. Traps: an enum with an ``__init__``, a class derived from an untyped library's, an
interpreted class derived from a compiled one, a value of another type than declared, ``...`` as a default, a constant tuple of
floats, a generic dataclass, ``object`` as the type of a field of a dataclass or named tuple, bytes with a slice from a constant,
two handlers of compiled exceptions with one name, the address of a local variable, which is released after its last use.
A constant is ``Final``, or it is looked up by its name in every cycle."""
SOAK = (
    "gateway/daemon/sync.py",
    "peers/drive/model/[!_]*.py",
    "peers/drive/drive.py",
    "peers/encoder/encoder.py",
    "peers/node/device.py",
    "peers/node/node.py",
    "peers/node/pdos.py",
    "peers/node/running.py",
    "peers/plc/exchange/endpoint.py",
    "peers/world/can_bus.py",
    "peers/world/udp.py",
    "profidrive/encoder.py",
    "profidrive/measuring.py",
)
"""Patterns of what else a soak runs in every cycle. ``PDGW_COMPILED=soak`` compiles it too, for no wheel of a release."""
RULES = Path("build/mypy.ini")
HEADERS = Path("build/c/pdgw")
"""Where mypyc writes the headers of the group, which its compiler options do not have."""
BUILD = os.environ.get("PDGW_COMPILED")
REQUESTED = BUILD in {"1", "soak"}
PATTERNS = COMPILED + SOAK if BUILD == "soak" else COMPILED


def section(override: dict[str, Any]) -> str:
    """What is said of other packages' types, as mypy's own file has it: the same as for the check."""
    rules = "".join(f"{name} = {value}\n" for name, value in override.items() if name != "module")
    return f"[mypy-{','.join(override['module'])}]\n{rules}"


def extensions() -> list[Any]:
    """The extension modules."""
    try:
        from mypyc.build import mypycify  # noqa: PLC0415
    except ImportError:
        return []  # asked for below; then this file runs again
    tools = tomllib.loads(Path("pyproject.toml").read_text(encoding="utf-8"))["tool"]
    RULES.parent.mkdir(exist_ok=True)
    RULES.write_text("[mypy]\n" + "".join(map(section, tools["mypy"]["overrides"])), encoding="utf-8")
    # An isolated build does not install the libraries, so mypy would report ignore comments for their types as unused.
    options = [f"--config-file={RULES}", "--strict", "--no-warn-unused-ignores"]
    options += ["--follow-imports=silent", "--ignore-missing-imports"]
    made: list[Any] = mypycify(
        [*options, *(str(file) for pattern in PATTERNS for file in sorted(Path("pdgw").glob(pattern)))],
        group_name="pdgw.compiled",
        # One C file for each module: a single one has 95 MB, of which four fifths are leading spaces.
        multi_file=True,
        # What the highest level adds is hardly to be measured, and twice as long in coming.
        opt_level="1",
        debug_level="0",
        target_dir=str(HEADERS.parent),
    )
    made[0].include_dirs.append(str(HEADERS))
    return made


setup(
    setup_requires=["mypy>=1.13"] if REQUESTED else [],
    ext_modules=extensions() if REQUESTED else [],
)
