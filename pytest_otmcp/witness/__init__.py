"""What the devices witness. Pure; one set of modules a protocol:

- decoders (``modbus``, ``mqtt``, ``sparkplug``, ``opcua``): recorded bytes to journal entries, written from the
  specifications and independent of mocks, adapters and the libraries these are made of;
- oracles (``*_oracle``): journal entries and images to findings, whoever wrote the journal.
"""
