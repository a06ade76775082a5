"""The shipped conformance suite as data: its tasks, and digests of suite and kit."""
