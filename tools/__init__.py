"""The ``pdgw`` command line: commands, demo, axis test, reports."""
