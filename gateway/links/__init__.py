"""The cyclic exchange with the PLC over UDP, and what both links share."""
