"""PROFIBUS DP: description, operations, decoder and oracles."""
