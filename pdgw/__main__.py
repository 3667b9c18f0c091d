"""``python -m pdgw`` is the command ``pdgw``."""

from pdgw.tools.cli import main

main()
