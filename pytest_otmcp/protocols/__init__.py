"""What the kit knows of each OT protocol, one sub-package a protocol. Pure.

- ``decoder``: recorded bytes to journal entries, written from the specifications and independent of mocks, adapters and
  the libraries these are made of;
- ``oracle``: journal entries and images to findings, whichever witness (mock or tap) wrote the journal.
"""
