"""Judging a stored run again: the same steps and oracles, with the record in the place of adapters and devices."""
