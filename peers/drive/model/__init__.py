"""The simulated drive without CANopen around it: shapes, power section, modes, motion and touch probe."""
