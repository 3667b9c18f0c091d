"""The configuration: models, file, checks, example, byte map and bus load."""
