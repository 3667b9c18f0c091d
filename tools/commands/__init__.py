"""One module per ``pdgw`` subcommand."""
