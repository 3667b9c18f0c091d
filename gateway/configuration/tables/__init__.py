"""The tables of a configuration file, with their defaults."""
