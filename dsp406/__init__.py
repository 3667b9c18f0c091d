"""CiA 406 encoders: objects, scaling, cams, and the encoder client.

Knows CANopen, but neither PROFIdrive nor drives; the gateway translates.
"""
