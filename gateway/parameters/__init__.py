"""The parameter channel: manager, profile parameters, CANopen objects, records, UDP server."""
