"""A configuration as the text of a file that gives it again."""

from __future__ import annotations

from fractions import Fraction

from pdgw.gateway.config import GatewayConfig
from pdgw.gateway.toml_file import toml_text

_PERCENT = "standstill_window_percent"


def config_text(config: GatewayConfig) -> str:
    """What is not as by default, as TOML."""
    document = config.model_dump(exclude_defaults=True)
    for item in document.get("axis", ()):
        if _PERCENT in item:
            item[_PERCENT] = float(Fraction(item[_PERCENT]) * 100)  # kept as a share, written as percent
    return toml_text(document)
