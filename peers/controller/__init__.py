"""A small PROFINET IO controller: finds the device by name, connects, exchanges data, reads and writes records, takes alarms."""
