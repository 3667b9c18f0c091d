"""The decoder and `pdgw timeline` on the same captures, beside other programs."""
