"""The PLC's side of the parameter channel: record client, addresses, dump and restore."""
