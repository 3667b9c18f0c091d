"""The gateway: daemon, store, and the packages that connect PLC and devices."""
