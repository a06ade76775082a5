"""What an item keeps beside its calls and journals, so that it can be judged again: observations and images. Pure.

Every time that the steps of a repetition look at a device, the repetition notes an *observation*, in their order. It names
the adapter (``at``, such as ``modbus`` or ``modbus@ro``) and has one member that says what was seen, without repeating
what the record has elsewhere:

``journal: next``            the journal's slice, up to the entry before sequence number ``next``
``wait: count``              that many matching entries had arrived when the waiting was over
``session_journal: [s, n]``  the entries from ``s`` to before ``n``: what came since the session was opened
``image: index``             the image of that index in the item's ``history.images``
``end: next``                the slice of this repetition ends before ``next``; the following one begins there
``stop: ms``                 the device was stopped, which took so long
``start: {…}``               the device was started: ``ms``, and ``accepting_ns`` when it accepted connections
``fresh_session: {…}``       a new session: ``spawned_ns``, and how the one before ``ended`` after ``seconds``

All ``…_ns`` are of the one monotonic clock that calls and journals have too.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from copy import deepcopy
from typing import Any

__all__ = ["Images", "restored_images"]


class Images:
    """Device images of one item: the first of each device whole, the others as what changed since; each but once."""

    def __init__(self) -> None:
        self.kept: list[dict[str, Any]] = []
        self._first: dict[str, tuple[int, dict[str, Any]]] = {}
        self._known: dict[str, int] = {}

    def keep(self, at: str, image: dict[str, Any]) -> int:
        """Keep an image; its index."""
        digest = at + json.dumps(image, sort_keys=True)
        if digest not in self._known:
            self._known[digest] = len(self.kept)
            index, first = self._first.setdefault(at, (len(self.kept), image))
            # An image with other members than the first has nothing in common that would be worth keeping.
            if first is image or first.keys() != image.keys():
                self.kept.append({"at": at, "image": image})
            else:
                self.kept.append({"since": index, "changes": list(_changes(first, image, []))})
        return self._known[digest]


def restored_images(kept: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The images as they were, from what :class:`Images` kept.

    Raises:
        KeyError, IndexError, TypeError, ValueError: this is not what an :class:`Images` has kept.
    """
    images: list[dict[str, Any]] = []
    for entry in kept:
        if "image" in entry:
            images.append(entry["image"])
            continue
        image: Any = deepcopy(images[entry["since"]])
        for path, value in entry["changes"]:
            *way, last = path
            place = image
            for step in way:
                place = place[step]
            place[last] = value
        images.append(image)
    return images


def _changes(old: Any, new: Any, path: list[str | int]) -> Iterable[list[Any]]:
    """``[path, value]`` for every place whose value is another one; a place that gained or lost members is one."""
    steps: Iterable[Any]
    if isinstance(old, dict) and isinstance(new, dict) and old.keys() == new.keys():
        steps = old
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        steps = range(len(old))
    else:
        # As JSON has it, true is not 1, and 1.0 is worth keeping apart from 1.
        if old != new or type(old) is not type(new):
            yield [path, new]
        return
    for step in steps:
        yield from _changes(old[step], new[step], [*path, step])
