"""Drive objects: axes and encoders bound to the clients of their nodes, enable chain, fault buffer, touch probe."""
