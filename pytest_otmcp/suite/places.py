"""Where the documentation explains an id: a page of its own for each requirement, item and code."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

from ..core.error_registry import registry
from ..core.matrix import BENCHMARK, REQUIREMENTS
from ..core.site import site
from .catalogue import known_tasks
from .explanations import findings
from .requirements import requirements

__all__ = ["address", "place"]


def place(identifier: str) -> str | None:
    """Return the path of the page that explains an id, from the folder of the documentation; None for an unknown id.

    A check is explained on the page of its row, an error code and the code of a finding that share a name on one page.
    """
    return _places().get(identifier)


def address(identifier: str) -> str | None:
    """Return the address of the page that explains an id on the site that is configured; None without a site, and for an unknown id."""
    path = place(identifier)
    if path is None or not site():
        return None
    page, _, anchor = path.partition(".md")
    return f"{site()}/{page}/{anchor}"


@cache
def _places() -> Mapping[str, str]:
    rows = requirements()
    found = {name: f"codes/{name}.md" for name in (*registry(), *findings())}
    found |= {name: f"requirements/{name}.md" for name in rows}
    for name, task in known_tasks().items():
        row = name.partition(".")[0]
        if task.suite == REQUIREMENTS and row in rows:
            found[name] = f"requirements/{row}.md#{name}"
        elif task.suite in BENCHMARK:
            found[name] = f"items/{name}.md"
    return found
