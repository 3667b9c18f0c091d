"""``pdgw web``: page, interface, metrics and MQTT, a process of its own that reads status port and flight recorder.

It asks the daemon's status socket and reads the cycle ring, and gives both to browsers, Prometheus and MQTT. It changes nothing:
no request of it can move a drive, and the daemon imports nothing of it. Needs the extra ``web`` (starlette, uvicorn,
prometheus_client); MQTT the extra ``mqtt`` (paho-mqtt).
"""
