"""The axis test: the first move of an axis, without a PLC."""
