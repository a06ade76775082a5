"""What ``otmcp init`` knows of the kit's own protocols: one module a protocol, each with a ``PACK``."""
