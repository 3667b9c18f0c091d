"""The records that a device serves of itself."""
