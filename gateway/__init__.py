"""The gateway: the axis machine (pure, ``axis``), drive objects bound to their nodes, transports, configuration, the daemon."""
