"""DNP3 (IEEE 1815) over TCP: description, operations, decoder and oracles."""
