"""Proofs that run against a gateway and simulated devices in this process."""
