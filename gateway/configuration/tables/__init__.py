"""The tables of a configuration file: buses and nodes, encoders, positioner, page, and their defaults."""
