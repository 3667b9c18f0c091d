"""The PROFINET device over a pair of virtual Ethernet interfaces."""
