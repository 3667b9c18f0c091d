"""The acyclic channel of PROFINET: connectionless DCE/RPC, record read and write, identification records; sans-I/O."""
