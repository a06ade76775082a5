"""``python -m tests.adapters_in_the_wild.init_section``: writes the section on ``otmcp init`` in ``docs/soundness.md`` anew.

A test compares it with the declarations.
"""

from __future__ import annotations

from pytest_otmcp.protocols.registry import protocols
from tests.soundness.document import DOCUMENT, with_section

from .init_launches import LAUNCHES, Launch

__all__ = ["section"]


def section() -> str:
    """Return the table of the adapters that ``otmcp init`` is tried on."""
    proven = sum(len(launch.proven) + len(launch.unfilled) for launch in LAUNCHES)
    commands = sum(len(launch.commands) for launch in LAUNCHES)
    lines = [
        f"**Proven and wrong: 0 of {proven} operations and {commands} named commands**, on "
        f"{len({launch.example for launch in LAUNCHES})} adapters.",
        "",
        "| adapter | protocol | operations | proven | of these, without their result | neither | named commands | entries left to fill in |",
        "|---|---|---|---|---|---|---|---|",
        *map(_row, LAUNCHES),
        "",
    ]
    return "\n".join(lines)


def _row(launch: Launch) -> str:
    found = {**launch.proven, **launch.unfilled}
    known = protocols()[launch.protocol].operations
    operations = [name for name, one in known.items() if not one.voluntary or name in found]
    shown = ", ".join(f"{name} by `{found[name]}`" for name in operations if name in found)
    neither = ", ".join(name for name in operations if name not in found)
    cells = (
        launch.example,
        protocols()[launch.protocol].name,
        len(operations),
        f"{len(found)}: {shown}",
        ", ".join(launch.unfilled),
        neither,
        ", ".join(f"`{name}`" for name in launch.commands),
        launch.left,
    )
    return f"| {' | '.join(map(str, cells))} |"


if __name__ == "__main__":
    DOCUMENT.write_text(with_section("init", section()), encoding="utf-8")
