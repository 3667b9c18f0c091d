"""The gateway and the commands on one that runs."""
