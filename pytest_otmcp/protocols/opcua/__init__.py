"""OPC UA (binary, opc.tcp): decoder and oracles."""
