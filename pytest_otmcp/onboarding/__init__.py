"""Proposes a subject file for an adapter that nobody has described yet: guessed from names, proven at a mock device.

A guess counts only when the device has seen what it should have seen; what stays a guess is said to be one.
"""
