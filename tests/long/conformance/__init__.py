"""Conformance tests with a gateway and simulated devices in this process."""
