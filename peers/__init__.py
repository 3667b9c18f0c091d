"""Everything that plays the other side: simulated nodes, drives, encoders, PLC and their faults; no part of the product."""
