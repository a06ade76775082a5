"""PROFINET IO: description, operations, decoder and oracles."""
