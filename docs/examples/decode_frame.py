"""Decode a cyclic frame of the PLC: what are these bytes?"""

import pdgw

FRAME = bytes.fromhex("C001 047F 2000 80 80" + "00" * 34 + "0020 35 00")

record = pdgw.recognise(FRAME, [1])
print(record.kind, record.summary)
for unit in record.units:
    print(*(field.text(raw) for field, raw in unit.items()), sep="\n")
