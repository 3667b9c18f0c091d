"""What a PLC exchanges with a gateway: frames, values of the telegrams, parameters; the parts that follow a telegram."""
