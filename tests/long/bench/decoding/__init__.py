"""Speed of the decoder and of `pdgw timeline`, compared with other programs on the same captures."""
