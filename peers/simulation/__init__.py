"""Simulated devices of one bus: device types, file, control at run time."""
