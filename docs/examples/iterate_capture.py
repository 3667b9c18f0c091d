"""Go through a capture of either bus: `python iterate_capture.py plc.pcap` or `can.log`."""

import sys

import pdgw

for record in pdgw.read_records(sys.argv[1], telegrams=[1]):
    for unit in record.units:
        values = {field.identifier: value for field, value in unit.items()}
        print(f"{record.time_ns / 1e9:.6f} {record.bus}: axis {unit.axis}: {values}")
