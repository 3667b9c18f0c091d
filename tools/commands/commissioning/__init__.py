"""Commands for a plant before its gateway runs: configuration, bus, drives, byte map, first move."""
