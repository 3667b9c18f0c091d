"""The replay: recorded inputs through today's axis machine."""
