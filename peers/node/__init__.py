"""What every simulated CANopen node has: object dictionary, SDO server, PDOs, heartbeats, faults."""
