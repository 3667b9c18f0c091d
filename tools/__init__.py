"""The ``pdgw`` command line."""
