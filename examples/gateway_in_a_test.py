"""A gateway and its drive inside a test: no ports, no sleeps, seconds of plant time in milliseconds, and each run like the last.

A `World` is the machine the gateway runs on: its clock, its CAN buses with simulated devices, its network. Run it with pytest, or
as it is.
"""

import pdgw
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint

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
CYCLE_NS = 4_000_000


def test_a_drive_turns_and_stops_when_the_plc_falls_silent() -> None:
    config = pdgw.parse_config(CONFIG)
    world = pdgw.World(seed=1)
    world.simulate(config)
    gateway = pdgw.build_gateway(config, world)
    gateway.start()

    plc = PlcEndpoint([pdgw.telegram(1)], CYCLE_NS)
    port = world.network.open("plc", 0, "PLC")
    port.start(lambda: plc.receive(port.receive()[0]))

    def exchange(seconds: float, **setpoints: int) -> None:
        plc.set(0, setpoints)
        for _ in range(round(seconds * 1e9) // CYCLE_NS):
            port.send(plc.build(world.loop.now()), gateway.address)
            world.loop.run_for(CYCLE_NS)

    exchange(2, STW1=OFF)
    exchange(2, STW1=ON, NSOLL_A=0x1000)
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
