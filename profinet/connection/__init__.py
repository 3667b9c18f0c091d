"""One application relationship: what its Connect asks, its state machine, cyclic data, system redundancy."""
