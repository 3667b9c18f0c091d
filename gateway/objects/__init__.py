"""Drive objects: axes and encoders bound to the clients of their nodes, and their enable chain."""
