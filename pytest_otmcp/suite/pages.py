"""The pages of the documentation that are built from the suite's own declarations, for ``otmcp docs``.

``python -m pytest_otmcp.suite.pages items`` prints one.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache

from ..core.error_registry import registry
from ..core.matrix import BENCHMARK, REQUIREMENTS
from ..trial.task import Task
from .catalogue import all_tasks
from .explanations import HOW_A_LEVEL_IS_EARNED, Explained, Part, error_code, explained, findings, item, requirement
from .places import place
from .requirements import Level, Requirement, catalogue, requirements

__all__ = ["FOLDERS", "PAGES", "page"]

_HEAD = "`otmcp docs {name}` builds this page from {origin}."

_READ = {"text": "the text", "titles": "numbers and titles", None: "nothing"}


def _items() -> Iterator[str]:
    yield "# The items"
    yield _HEAD.format(name="items", origin="the declarations of the tasks")
    yield (
        "Each item is one task of the suite: what an assistant asks for, what the adapter must say, and what the device must have "
        "seen. `otmcp explain M3` prints the page of an item."
    )
    tasks = all_tasks().values()
    for suite in BENCHMARK:
        yield f"## {suite.capitalize()} suite"
        yield _table(
            ("item", "protocol", "what is asked"),
            ((_link(task.id), task.family, task.title) for task in tasks if task.suite == suite),
        )


def _checks() -> Iterator[str]:
    yield "# The checks of the requirement suite"
    yield _HEAD.format(name="checks", origin="the declarations of the checks")
    yield (
        "Each check is about one row of the catalogue and one protocol; the page of the row has its checks. "
        "`pytest --otmcp-only=WR-003` runs those of a row, and `otmcp explain` prints one."
    )
    by_row = _checks_by_row()
    for area, heading in catalogue().areas.items():
        rows = [row for row in by_row if requirements()[row].area == area]
        if rows:
            yield f"## {area}: {heading}"
            yield _table(
                ("row", "what has to be done", "checked over"),
                (
                    (
                        _link(row),
                        _first_sentence(requirements()[row]),
                        ", ".join(f"[{task.family}]({place(task.id)})" for task in by_row[row]),
                    )
                    for row in rows
                ),
            )


@cache
def _checks_by_row() -> Mapping[str, list[Task]]:
    by_row: dict[str, list[Task]] = {}
    for task in all_tasks().values():
        if task.suite == REQUIREMENTS:
            by_row.setdefault(task.id.partition(".")[0], []).append(task)
    return by_row


def _requirements() -> Iterator[str]:
    yield "# The requirements"
    yield _HEAD.format(name="requirements", origin="`conformance/requirements.toml`")
    yield (
        "These are the rows of the requirement catalogue: what an adapter between assistants and a plant has to do. Only a MUST that is "
        "not met turns an item red. A row that is not yet judged says why, and counts for no level. The page of a row has its source, "
        "and what the checks about it ask, over each protocol; `otmcp explain WR-003` prints the row."
    )
    yield "## Levels and profiles"
    yield f"{HOW_A_LEVEL_IS_EARNED} Gold cannot be earned over a protocol of which the kit knows no secure form, nor by an adapter over HTTP yet."
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


def _cells(row: Requirement) -> tuple[str, ...]:
    not_yet = " *Not yet judged.*" if row.not_yet else ""
    return _link(row.id), row.strength, row.level.capitalize(), f"{_first_sentence(row)}{not_yet}"


def _first_sentence(row: Requirement) -> str:
    first, _, _ = row.statement.partition(". ")
    return f"{first.removesuffix('.')}."


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
    yield _table(("code", "meaning"), ((_link(one.code), error_code(one).about) for one in registry().values()))
    yield "## Codes of findings"
    yield _table(("code", "meaning"), ((_link(code), entry.meaning) for code, (entry, _) in findings().items()))


_UP = "[All {0}](../{0}.md)"


def _pages_of_items() -> Iterator[tuple[str, Iterable[str]]]:
    for task in all_tasks().values():
        if task.suite in BENCHMARK:
            yield task.id, [_UP.format("items"), f"# {task.id}", *_body(item(task))]


def _pages_of_requirements() -> Iterator[tuple[str, Iterable[str]]]:
    for row in requirements().values():
        checks = _checks_by_row().get(row.id, [])
        yield row.id, [_UP.format("requirements"), f"# {row.id}", *_body(requirement(row)), *_asked(checks)]


def _asked(tasks: Iterable[Task]) -> Iterator[str]:
    """Yield what the checks of a row ask: one section for those that ask the same over several protocols."""
    alike: dict[tuple[str, tuple[Part, ...]], list[tuple[Task, Explained]]] = {}
    for task in tasks:
        one = item(task)
        same = tuple(part for part in one.parts if part[0] not in _OF_A_CHECK)
        alike.setdefault((one.about, same), []).append((task, one))
    if alike:
        yield "## What the kit asks"
    for (about, parts), checks in alike.items():
        # The anchors stand before the heading, so that a link shows it.
        yield "".join(f'<a id="{task.id}"></a>' for task, _ in checks)
        yield f"### {', '.join(task.family for task, _ in checks)}"
        yield about
        yield from _paragraphs(parts)
        yield _table(
            ("check", "applies to"),
            ((f"`{task.id}`", text) for task, one in checks for text in dict(one.parts)[_APPLIES]),
        )


_APPLIES = "Applies to"
_OF_A_CHECK = ("Suite", _APPLIES, "Rules")
"""What differs from protocol to protocol, or is said of the row."""


def _pages_of_codes() -> Iterator[tuple[str, Iterable[str]]]:
    # An error and a finding may have the same code.
    for code in dict.fromkeys([*registry(), *findings()]):
        yield (
            code,
            [
                _UP.format("codes"),
                f"# {code}",
                *(text for one in explained(code) for text in (f"## As {_A[one.kind]}", *_body(one))),
            ],
        )


_A = {"error code": "the code of an error", "finding code": "the code of a finding"}


PAGES: Mapping[str, Callable[[], Iterator[str]]] = {
    "items": _items,
    "checks": _checks,
    "requirements": _requirements,
    "codes": _codes,
}
"""Name of a page to its paragraphs."""


FOLDERS: Mapping[str, Callable[[], Iterator[tuple[str, Iterable[str]]]]] = {
    "items": _pages_of_items,
    "requirements": _pages_of_requirements,
    "codes": _pages_of_codes,
}
"""Name of a folder to its pages: the id that each explains, and its paragraphs."""


def _body(one: Explained) -> Iterator[str]:
    yield one.about
    yield from _paragraphs(one.parts)


def _paragraphs(parts: Iterable[Part]) -> Iterator[str]:
    for label, texts in parts:
        shown = [_linked(text) for text in texts]
        if len(shown) == 1:
            yield f"**{label}.** {shown[0]}"
        else:
            yield f"**{label}.**"
            yield "\n".join(map("- {}".format, shown))


def _link(identifier: str) -> str:
    return f"[{identifier}]({place(identifier)})"


def _linked(text: str) -> str:
    """Make links of the ids of items and requirements, and code of keys of the subject file. For pages of a folder."""
    text = re.sub(r"\(docs/([\w-]+)\.md(#[\w-]+)?\)", r"([\1](../\1.md\2))", text)
    text = re.sub(r"^((?:\[adapter\.\w+\] )?[a-z_]+(?:\.[a-z_]+)?)(?=: )", r"`\1`", text)

    def link(match: re.Match[str]) -> str:
        name = match.group()
        path = place(name)
        return name if path is None else f"[{name}](../{path})"

    # The id of a check has the key of its protocol behind a stop; a stop at the end of a sentence has nothing behind it.
    return re.sub(r"(?<![\w`-])[A-Z][A-Z0-9]*(?:-?[A-Za-z0-9]+)*(?:\.[a-z][a-z0-9]*(?!\w))?(?![\w`-])", link, text)


def page(name: str) -> str:
    """Return a page as it is written.

    Args:
        name: one of ``PAGES``; or one of ``FOLDERS`` with a slash, for a JSON object of its pages by their file names.
    """
    if name.endswith("/"):
        return json.dumps({f"{one}.md": _joined(parts) for one, parts in FOLDERS[name[:-1]]()})
    return _joined(PAGES[name]())


def _joined(paragraphs: Iterable[str]) -> str:
    return "\n\n".join(paragraphs) + "\n"


if __name__ == "__main__":
    sys.stdout.write(page(sys.argv[1]))
