"""The PROFINET link: an IO device on an Ethernet interface."""
