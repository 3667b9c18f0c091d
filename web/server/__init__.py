"""The server of the page: its connections, who may ask, and large answers."""
