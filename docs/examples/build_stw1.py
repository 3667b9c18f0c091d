"""Build the setpoints of telegram 1: the control word by the names of its bits, the speed in percent."""

import pdgw

RELEASES = ("NO_COAST_STOP", "NO_QUICK_STOP", "ENABLE_OPERATION")
RAMP = ("ENABLE_RAMP_GENERATOR", "UNFREEZE_RAMP_GENERATOR", "ENABLE_SETPOINT")

stw1 = pdgw.signal("STW1")
nsoll_a = pdgw.signal("NSOLL_A")
off = stw1.word(*RELEASES, *RAMP, "CONTROL_BY_PLC")
on = stw1.word("ON", *RELEASES, *RAMP, "CONTROL_BY_PLC")
print(f"OFF {off:04X}h, ON {on:04X}h")

half = pdgw.telegram(1).setpoints
data = half.encode(half.from_dict({"STW1": on, "NSOLL_A": nsoll_a.raw(12.5)}))
print(data.hex(" "))
