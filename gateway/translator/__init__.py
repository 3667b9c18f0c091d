"""Translators: one PROFIdrive telegram to one CANopen drive and back, as pure state machines.

No sockets, buses, clocks, threads or logging: values and a time in, values and events out. See ``base.Translator``.
"""
