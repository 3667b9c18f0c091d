"""A gateway and its drive inside a test: no ports, no sleeps, seconds of plant time in milliseconds, and each run like the last.

A `World` is the machine the gateway runs on: its clock, its CAN buses with simulated devices, its network. Run it with pytest, or
as it is.
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
OFF, ON = 0x047E, 0x047F


def test_a_drive_turns_and_stops_when_the_plc_falls_silent() -> None:
    config = pdgw.parse_config(CONFIG)
    world = pdgw.World(seed=1)
    world.simulate(config)
    gateway = pdgw.build_gateway(config, world)
    gateway.start()

    plc = pdgw.Plc(world, gateway)
    plc.exchange(2, STW1=OFF)
    plc.exchange(2, STW1=ON, NSOLL_A=0x1000)
    assert plc.actuals[0]["ZSW1"] & 0x4F == 0x07, "operation enabled"
    assert abs(plc.actuals[0]["NIST_A"] - 0x1000) < 0x20

    world.loop.run_for(3_000_000_000)
    assert plc.actuals[0]["ZSW1"] & 0x04 == 0, "power is off"
    assert plc.actuals[0]["NIST_A"] == 0

    gateway.stop()
    world.loop.until(gateway.stopped.is_set, "the end of the gateway")


if __name__ == "__main__":
    test_a_drive_turns_and_stops_when_the_plc_falls_silent()
    print("the drive turned, and stopped when the PLC fell silent")
