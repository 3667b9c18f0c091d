"""CiA 406 encoders: objects, scaling and cams, the client of a real encoder, and a simulated one.

Knows CANopen, but neither PROFIdrive nor drives; the gateway translates.
"""
