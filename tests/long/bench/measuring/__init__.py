"""Tools of the measurements: schedules, phases, percentiles, build information."""
