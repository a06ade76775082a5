"""The pages of the documentation that are built from the suite's own declarations, for ``otmcp docs``.

``python -m pytest_otmcp.suite.pages items`` prints one.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache

from ..core.error_registry import registry
from ..core.matrix import BENCHMARK, REQUIREMENTS
from .catalogue import all_tasks
from .explanations import HOW_A_LEVEL_IS_EARNED, Explained, error_code, finding_code, findings, item, requirement
from .requirements import Level, Requirement, catalogue, requirements

__all__ = ["PAGES", "page"]

_HEAD = "`otmcp docs {name}` builds this page from {origin}."

_READ = {"text": "the text", "titles": "numbers and titles", None: "nothing"}


def _items() -> Iterator[str]:
    yield "# The items"
    yield _HEAD.format(name="items", origin="the declarations of the tasks")
    yield (
        "Each item is one task of the suite: what an assistant asks for, what the adapter must say, and what the device must have "
        "seen. `otmcp explain M3` prints the same."
    )
    tasks = all_tasks().values()
    for suite in BENCHMARK:
        yield f"## {suite.capitalize()} suite"
        yield from _sections(item(task) for task in tasks if task.suite == suite)


def _checks() -> Iterator[str]:
    yield "# The checks of the requirement suite"
    yield _HEAD.format(name="checks", origin="the declarations of the checks")
    yield (
        "Each check is about one row of the catalogue and one protocol. `pytest --otmcp-only=WR-003` runs those of a row, and "
        "`otmcp explain` with the id of a check prints the same as this page."
    )
    yield from _sections((item(task) for task in all_tasks().values() if task.suite == REQUIREMENTS), "##")


def _requirements() -> Iterator[str]:
    yield "# The requirements"
    yield _HEAD.format(name="requirements", origin="`conformance/requirements.toml`")
    yield (
        "These are the rows of the requirement catalogue: what an adapter between assistants and a plant has to do. Only a MUST that is "
        "not met turns an item red. A row that is not yet judged says why, and counts for no level. `otmcp explain WR-003` prints "
        "the same."
    )
    yield "## Levels and profiles"
    yield f"{HOW_A_LEVEL_IS_EARNED} Gold cannot be earned yet: rows that it needs are not yet judged."
    yield _table(("level", "what its adapter is good for"), ((level.capitalize(), level.meaning) for level in Level))
    profiles = catalogue().profiles.values()
    yield _table(
        ("profile", "what it is about", "from level"),
        ((f"`{profile.id}`", profile.meaning, profile.level.capitalize()) for profile in profiles),
    )
    yield "## Documents"
    yield (
        "A row rests on its source: places in documents whose text the authors of the catalogue have read. Related documents are on the "
        "same matter, and a row quotes nothing of them. Where only tables of numbers and titles were read, which others have "
        "published, a row names the requirements that it is evidence towards; it does not show that they are met."
    )
    documents = catalogue().documents.values()
    yield _table(
        ("name", "document", "to be had at", "what was read"),
        ((one.name, one.title, one.at, _READ[one.read]) for one in documents),
    )
    for area, heading in catalogue().areas.items():
        rows = [row for row in requirements().values() if row.area == area]
        yield f"## {area}: {heading}"
        yield _table(("id", "strength", "level", "what has to be done"), map(_cells, rows))
        yield from _sections(map(requirement, rows))


def _cells(row: Requirement) -> tuple[str, ...]:
    first, _, _ = row.statement.partition(". ")
    not_yet = " *Not yet judged.*" if row.not_yet else ""
    return _linked(row.id), row.strength, row.level.capitalize(), f"{first.removesuffix('.')}.{not_yet}"


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (head, ("---",) * len(head), *rows))


def _codes() -> Iterator[str]:
    yield "# The codes"
    yield _HEAD.format(name="codes", origin="`core/errors.toml` and the files `findings.toml`")
    yield (
        "`error.code` of an answer is one of the error codes, or begins with `x_`; the rules `errors` of a subject file use the "
        "same ones. A finding of the kit has a code, too. `otmcp explain illegal_address` prints the same."
    )
    yield "## Error codes"
    yield from _sections(map(error_code, registry().values()))
    yield "## Codes of findings"
    yield from _sections(map(finding_code, findings()))


PAGES: Mapping[str, Callable[[], Iterator[str]]] = {
    "items": _items,
    "checks": _checks,
    "requirements": _requirements,
    "codes": _codes,
}
"""Name of a page to its paragraphs."""


def _sections(entries: Iterable[Explained], level: str = "###") -> Iterator[str]:
    for one in entries:
        # An anchor of its own: error and finding may have the same code.
        yield f'<a id="{one.kind.partition(" ")[0]}-{one.id}"></a>'
        yield f"{level} {one.id}"
        yield one.about
        for label, texts in one.parts:
            shown = [_linked(text) for text in texts]
            yield (
                f"**{label}.** {shown[0]}"
                if len(shown) == 1
                else "\n".join([f"**{label}.**", *map("- {}".format, shown)])
            )


def _linked(text: str) -> str:
    """Make links of the ids of items and requirements, and code of keys of the subject file."""
    text = re.sub(r"^((?:\[adapter\.\w+\] )?[a-z_]+(?:\.[a-z_]+)?)(?=: )", r"`\1`", text)

    def link(match: re.Match[str]) -> str:
        name = match.group()
        if name in requirements():
            return f"[{name}](requirements.md#requirement-{name})"
        page = _pages_of_tasks().get(name)
        return name if page is None else f"[{name}]({page}.md#item-{name})"

    # The id of a check has the key of its protocol behind a stop; a stop at the end of a sentence has nothing behind it.
    return re.sub(r"(?<![\w`-])[A-Z][A-Z0-9]*(?:-?[A-Za-z0-9]+)*(?:\.[a-z]+(?!\w))?(?![\w`-])", link, text)


@cache
def _pages_of_tasks() -> Mapping[str, str]:
    """Return the page that explains each task, by the task's id; looking tasks up anew for each link takes seconds."""
    return {name: "checks" if task.suite == REQUIREMENTS else "items" for name, task in all_tasks().items()}


def page(name: str) -> str:
    """Return a page as Markdown."""
    return "\n\n".join(PAGES[name]()) + "\n"


if __name__ == "__main__":
    print(page(sys.argv[1]), end="")
