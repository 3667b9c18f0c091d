"""What runs beside ``pdgw run``: its log and its child processes."""
