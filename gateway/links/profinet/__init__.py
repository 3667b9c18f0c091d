"""The PROFINET device on its Ethernet interface."""
