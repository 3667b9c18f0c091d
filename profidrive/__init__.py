"""PROFIdrive: data types, signals, telegrams, cyclic frame, encoder states, scapy layers.

Knows nothing of CANopen, sockets, clocks or threads: bytes, values and times in, bytes and values out.
"""
