"""What the process of the gateway needs beside the exchange: status, service manager, real time."""
