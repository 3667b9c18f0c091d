"""Before and during commissioning: scan of a bus, telegram check."""
