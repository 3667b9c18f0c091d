"""The model of the simulated drive without CANopen: power section, modes, motion, touch probe."""
