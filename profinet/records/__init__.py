"""The records of the device itself."""
