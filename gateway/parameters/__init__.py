"""The parameters of the gateway: profile parameters bound to axes, CANopen objects one to one, identification records."""
