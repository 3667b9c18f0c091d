"""The configuration: reading, checks, example, byte map and bus load."""
