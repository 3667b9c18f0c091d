"""A gateway and its drive inside a test: no ports, no sleeps, seconds of plant time in milliseconds, and each run like the last.

`pdgw.Gateway` runs in a `World`: its clock, its CAN buses with simulated devices, its network. Run it with pytest, or as it is.
"""

import pdgw

CONFIG = """
[can]
interface = "virtual"
channel = "bus"
[transport]
watchdog_factor = 10
[[axis]]
do_id = 1
node_id = 1
telegram = 1
simulate = true
"""


def test_a_drive_turns_and_stops_when_the_plc_falls_silent() -> None:
    with pdgw.Gateway(pdgw.parse_config(CONFIG)) as gateway:
        plc = gateway.plc
        plc.run(3, on=True, speed="750 rpm")
        assert abs(plc.actual("NIST_A") - 0x1000) < 0x20

        gateway.world.loop.run_for(3_000_000_000)
        assert plc.actual("ZSW1") & 0x04 == 0, "power is off"
        assert plc.actual("NIST_A") == 0
        assert "PLC" in gateway.sentence(1)


if __name__ == "__main__":
    test_a_drive_turns_and_stops_when_the_plc_falls_silent()
    print("the drive turned, and stopped when the PLC fell silent")
