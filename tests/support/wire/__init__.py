"""PROFINET and Ethernet: requests, a device and a controller on one wire."""
