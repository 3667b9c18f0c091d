"""DCE/RPC, record access, identification records, endpoint mapper; sans-I/O."""
