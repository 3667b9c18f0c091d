"""Executors with positions: positioner, homing, modes, generated positions."""
