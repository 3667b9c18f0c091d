"""The axis test: first move of an axis without a PLC."""
