"""How cyclic frames and parameter requests of the PLC reach the gateway."""
