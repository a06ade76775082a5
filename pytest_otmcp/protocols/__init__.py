"""What the kit knows of each OT protocol, one sub-package a protocol. Pure.

- ``protocol``: what a description holds; ``registry``: which protocols there are;
- ``journal``: the contract of journal entries and images, and the oracles that need nothing of a protocol;
- in a protocol's package: its description, operations, decoder (recorded bytes to journal entries, written from the
  specifications and independent of mocks, adapters and the libraries these are made of) and oracles (journal entries and
  images to findings, whichever witness, mock or tap, wrote the journal).
"""
