"""One application relationship: Connect, state machine, cyclic data, system redundancy."""
