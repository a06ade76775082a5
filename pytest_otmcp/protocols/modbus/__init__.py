"""Modbus TCP: decoder and oracles."""
