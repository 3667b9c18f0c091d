"""Conformance of the gateway: telegrams, drive shapes, and faults of simulated devices (``make conformance``)."""
