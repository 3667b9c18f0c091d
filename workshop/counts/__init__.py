"""Counts that do not depend on how fast or busy the machine is: what a cycle costs, compared with ``golden.toml``."""
