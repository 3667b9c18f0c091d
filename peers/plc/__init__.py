"""The PLC simulator: endpoint, scenario language, keyboard."""
