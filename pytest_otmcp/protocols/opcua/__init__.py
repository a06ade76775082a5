"""OPC UA (binary encoding, opc.tcp): description, operations, decoder and oracles."""
