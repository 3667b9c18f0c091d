"""Executors with positions: positioner, homing, modes."""
