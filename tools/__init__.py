"""The ``pdgw`` command line and what stands behind it: PLC simulator, demo, benchmarks, conformance."""
