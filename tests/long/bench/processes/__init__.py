"""The processes of a benchmark: gateway, ideal drives, echoes."""
