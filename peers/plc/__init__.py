"""The PLC simulator: controller side of the cyclic relationship, scenario language, UDP client."""
