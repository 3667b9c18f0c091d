"""Log and child processes of ``pdgw run``."""
