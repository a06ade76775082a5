"""``python -m pytest_otmcp.cli``: the same as the command ``otmcp``."""

from __future__ import annotations

import sys

from . import main

if __name__ == "__main__":
    sys.exit(main())
