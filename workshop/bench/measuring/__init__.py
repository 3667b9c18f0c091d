"""Measuring: schedules, phases, percentiles, and the build that was measured."""
