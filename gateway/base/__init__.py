"""The ground of the gateway: errors, reasons and fault numbers, platform, identity, parameter store."""
