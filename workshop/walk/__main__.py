"""``python -m pdgw.workshop.walk``: walk and print."""

from __future__ import annotations

import sys
import time
from itertools import product

from pdgw.ds301.eds import write_eds
from pdgw.ds301.eds_import import import_eds
from pdgw.dsp402.describe import answers_of_defaults, describe
from pdgw.dsp402.drive_type import DriveType
from pdgw.durations import MS
from pdgw.gateway.axis.settings import AxisSettings
from pdgw.peers.drive import shape
from pdgw.workshop.walk.drive import anything
from pdgw.workshop.walk.machine import Transducer
from pdgw.workshop.walk.monitor import Expected, Monitor
from pdgw.workshop.walk.plc import speed_words
from pdgw.workshop.walk.search import walk


def _drive() -> DriveType:
    chosen = shape("engel")
    dictionary = import_eds(write_eds(chosen.info, chosen.objects()).encode(), 1).dictionary
    return describe(dictionary, answers_of_defaults(dictionary))


def main() -> int:
    """Walk all settings; 1 when a rule is broken."""
    number = int(sys.argv[1])
    machine = Transducer(number, AxisSettings(reaction_ns=0, stop_time_ns=50 * MS), _drive(), int(sys.argv[2]) * MS)
    inputs = list(product(speed_words(number), anything()))
    began = time.process_time()
    result = walk(machine, Monitor(Expected()), inputs, limit=int(sys.argv[3]))
    for violation in result.violations.values():
        print(violation)
    print(
        len(inputs),
        result.machine_states,
        result.states,
        result.transitions,
        machine.computed,
        time.process_time() - began,
    )
    return 1 if result.violations else 0


if __name__ == "__main__":
    sys.exit(main())
