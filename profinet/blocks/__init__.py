"""The blocks of PROFINET IO as declarations, by service: connect, control, records, diagnosis and alarms."""
