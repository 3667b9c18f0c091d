"""DCP, LLDP and SNMP."""
