"""Who is on the network: DCP, LLDP, and the SNMP agent that shows both."""
