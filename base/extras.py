"""Which extra of this package brings an optional dependency, and the sentence that says so where it is missing.

Every package may import it.
"""

from __future__ import annotations

from collections.abc import Mapping

EXTRA_OF: Mapping[str, str] = {
    "matplotlib": "plot",
    "paho": "mqtt",
    "playwright": "browser",
    "prometheus_client": "web",
    "pyarrow": "parquet",
    "scapy": "scapy",
    "starlette": "web",
    "uvicorn": "web",
}
"""The extra of each package that some part of the product imports, by the name that is imported."""


def missing(package: str, purpose: str = "this") -> str:
    """One line: ``purpose`` needs ``package``, and the command that installs its extra."""
    return f"{purpose} needs {package}: pip install 'profidrive-gateway[{EXTRA_OF[package]}]'"
