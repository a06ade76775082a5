"""Proposes a subject file for an adapter that has none: guessed from names, proven at a mock device.

A guess counts only when the device has seen what it should have seen; what stays a guess is said to be one.

- ``matching`` guesses tools and arguments (``guess``) from names, ``experimenter`` tries guesses at a mock device and
  ``evidence`` finds its values in answers; ``drafting`` does this for every operation, ``document`` writes the file;
- ``pack``: what a protocol contributes, words and experiments; ``packs``: those of the kit's own protocols;
- ``known_causes``: why an adapter does not start.
"""
