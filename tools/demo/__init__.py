"""``pdgw demo``: three processes, one scenario and a report."""
