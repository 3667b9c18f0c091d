"""``pdgw demo``: three processes, one story, a report anyone can check."""
