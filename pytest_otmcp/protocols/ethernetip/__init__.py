"""EtherNet/IP with the tags of Logix controllers: description, operations, decoder and oracles."""
