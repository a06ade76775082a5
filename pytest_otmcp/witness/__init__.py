"""What the devices witness: pure functions from journal entries and images to findings.

One module per protocol. None of them knows the mocks' code or the adapters': they read the journal's fields, whoever
wrote them.
"""
