"""Ports the gateway has by default beside those of the standards; a command shows them without loading the configuration."""

STATUS_PORT = 34965
"""TCP on loopback: the answer to `pdgw status`."""
