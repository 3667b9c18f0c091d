"""``python -m tools`` is ``pdgw``."""

from tools.cli import main

main()
