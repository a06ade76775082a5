"""Modbus TCP: description, operations, decoder and oracles."""
