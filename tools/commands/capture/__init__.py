"""Commands on captures and recordings of both buses."""
