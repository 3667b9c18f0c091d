"""PROFIdrive: signals, telegrams, PROFINET cyclic frames and the parameter channel.

Knows nothing of CANopen, sockets, clocks or threads: bytes, values and times in, bytes and values out.
"""
