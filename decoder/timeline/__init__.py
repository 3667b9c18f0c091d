"""The timeline: records of both buses to entries in the order of time."""
