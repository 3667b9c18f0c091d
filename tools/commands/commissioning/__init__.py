"""Commands used before the gateway runs: configuration, bus scan, drives, byte map, axis test."""
