"""Classic S7 communication (S7comm): description, operations, decoder and oracles."""
