"""EtherCAT: description, operations, decoder and oracles."""
