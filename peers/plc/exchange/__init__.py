"""Frames, values and parameters that a PLC exchanges with a gateway."""
