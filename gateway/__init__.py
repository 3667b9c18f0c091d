"""The gateway: translators (pure), axes and their supervision, transports, configuration, the daemon."""
