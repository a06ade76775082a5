"""The kit's knowledge of each OT protocol, one sub-package for each. Pure.

- ``protocol``: the members of a description; ``registry``: the protocols that there are;
- ``journal``: the contract of journal entries and images; ``oracle``: the oracles that need nothing of a protocol;
- in a protocol's package: its description, operations, decoder (recorded bytes to journal entries, written from the
  specifications and independent of mocks, adapters and the libraries that these use) and oracles (journal entries and
  images to findings, whether a mock or a tap wrote the journal).
"""
