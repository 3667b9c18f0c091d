"""``pdgw run`` and the commands for a running gateway."""
