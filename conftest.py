"""Of this checkout only: lets the kit's own tests run pytest inside pytest.

Where the checkout is installed and the suite runs in somebody else's repository, this is none of the top-level conftests,
to which pytest restricts ``pytest_plugins``.
"""

from __future__ import annotations

from pathlib import Path

if Path.cwd().is_relative_to(Path(__file__).parent):
    pytest_plugins = ["pytester"]
