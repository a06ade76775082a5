"""The packs of the kit's own protocols for ``otmcp init``: one module per protocol, each with a ``PACK``."""
