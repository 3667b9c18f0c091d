"""Four tables of measurements: the cyclic exchange, the PROFINET device, stop times, decoder and timeline."""
