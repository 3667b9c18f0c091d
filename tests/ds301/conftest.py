"""A node of a device profile for the tests of the node's client."""

from tests.dsp402.conftest import plant

__all__ = ["plant"]
