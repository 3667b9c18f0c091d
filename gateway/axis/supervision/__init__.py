"""Supervision of an axis: sign of life, stops, enables, velocity and events of the drive."""
