"""The proposal of a subject file for an adapter that has none: guessed from names, proven at a mock device.

A guess counts as proven only when the device has seen the expected request; the file marks all others as guesses.

- ``matching`` guesses tools and arguments (``guess``) from names and from schemas (``input_schema``), ``experimenter`` tries
  guesses at a mock device, ``status`` also without it, and ``evidence`` finds its values in answers; ``drafting`` does this for
  every operation, ``document`` writes the file;
- ``pack``: the words and experiments that a protocol contributes; ``packs``: those of the kit's own protocols;
- ``known_causes``: known reasons why an adapter does not start.
"""
