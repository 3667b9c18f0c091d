"""CAN frames to records of CANopen."""
