"""Runs in a network namespace: ``pdgw run`` on one end of a veth pair, docs/examples/open_controller.py on the other.

Arguments: configuration, GSDML file, the example. What it prints and the exit status are the example's.
"""

from __future__ import annotations

import subprocess
import sys
import time

from pdgw.tools.demo.namespaces import THERE, VethPair

PATIENCE_S = 300


def main(config: str, gsdml: str, example: str) -> int:
    """Try until the station is there; a busy machine may also end a relationship too early."""
    end = time.monotonic() + PATIENCE_S
    with VethPair() as pair, subprocess.Popen([sys.executable, "-m", "pdgw", "run", config]) as gateway:
        # Isolated: a folder of this repository has the name of the controller's package.
        command = pair.command(sys.executable, "-I", example, THERE, "press-1", gsdml)
        while True:
            result = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
            if not result.returncode or time.monotonic() > end:
                break
        gateway.terminate()
    print(result.stdout, end="")
    print(result.stderr, file=sys.stderr)
    return result.returncode


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:4]))
