"""The working folder of an adapter, which may do in it whatever it likes."""

from __future__ import annotations

import os
import tempfile
import weakref

from ..core.files import remove_tree

__all__ = ["WorkFolder"]


class WorkFolder:
    """A new temporary folder. Nobody else gets into it, whatever becomes of its mode; it ends with :meth:`cleanup`, or with this object.

    Attributes:
        name: its path.
    """

    def __init__(self) -> None:
        # The folder above is this user's alone, and no adapter behind walls can change that.
        above = tempfile.mkdtemp(prefix="otmcp-")
        self.name = os.path.join(above, "work")
        os.mkdir(self.name)
        self.cleanup = weakref.finalize(self, remove_tree, above)
        """Remove it with all that is in it."""
