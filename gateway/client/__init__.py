"""The parameter client: UDP and PROFINET, dump and restore, identification."""
