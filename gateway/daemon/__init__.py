"""The roof of the gateway: the daemon, and how it is assembled from a configuration."""
