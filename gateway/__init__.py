"""The gateway, from its ground (``base``) to its roof (``daemon``)."""
