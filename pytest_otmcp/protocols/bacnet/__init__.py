"""BACnet/IP: description, operations, decoder and oracles."""
