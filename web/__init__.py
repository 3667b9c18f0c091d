"""The web page of a gateway, its metrics and its MQTT publisher: ``pdgw web``, a process of its own beside the daemon.

It asks the daemon's status socket and reads the cycle ring, and gives both to browsers, Prometheus and MQTT. It changes nothing:
no request of it can move a drive, and the daemon imports nothing of it. Needs the extra ``web`` (starlette, uvicorn,
prometheus_client); MQTT the extra ``mqtt`` (paho-mqtt).
"""
