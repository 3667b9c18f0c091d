"""Executors of telegrams with tasks: positioners, homing, modes, and positions for drives without profile position."""
