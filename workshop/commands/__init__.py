"""One module per command of ``python -m pdgw.workshop``."""
