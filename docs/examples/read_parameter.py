"""Read parameters of a running gateway: `python read_parameter.py [PORT]`, for example of `pdgw run --simulate`."""

import sys

import pdgw

port = int(sys.argv[1]) if len(sys.argv) > 1 else 34964
for element in pdgw.read_parameters(("127.0.0.1", port), 1, "P922", "P964.0", "6041h"):
    print(element.pnu, element.subindex, element.error_text if element.failed else element.value)
