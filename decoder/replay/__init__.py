"""Replay: a recording through the axis machine of this version."""
