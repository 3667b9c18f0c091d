"""Decode a cyclic frame of the PLC: what are these bytes?"""

import pdgw

FRAME = bytes.fromhex("C001 047F 2000 80 80" + "00" * 34 + "0020 35 00")

document = pdgw.recognise(FRAME, pdgw.telegram(1))
print(document["why"])
for name, signal in document["signals"].items():
    bits = [bit for bit, value in signal["bits"].items() if value]
    print(f"{name} = {signal['value']} {signal['unit']}".rstrip(), *bits)
