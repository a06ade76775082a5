"""Device images as a record has them: the first of each device in full, later images as their differences from it. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from copy import deepcopy
from typing import Any

from .schema import Change

__all__ = ["Images", "keep_image", "restore_image"]

Images = dict[str, dict[str, Any]]
"""The last image of each device that was kept in full, by the adapter's name."""


def keep_image(images: Images, at: str, image: dict[str, object]) -> tuple[str, object]:
    """Return the member of an observation for an image: ``image``, or ``changes`` since the last image kept in full."""
    full = images.get(at)
    # An image with other members has too little in common with the full one for differences to pay.
    if full is None or full.keys() != image.keys():
        images[at] = image
        return "image", image
    return "changes", list(_changes(full, image, []))


def restore_image(images: Images, at: str, seen: Mapping[str, Any]) -> dict[str, Any]:
    """Return the image of an observation that has ``image`` or ``changes``.

    Raises:
        KeyError, IndexError, TypeError, ValueError: the member is none that :func:`keep_image` has returned.
    """
    if "image" in seen:
        images[at] = seen["image"]
        return images[at]
    image: dict[str, Any] = deepcopy(images[at])
    for path, value in seen["changes"]:
        *way, last = path
        place: Any = image
        for step in way:
            place = place[step]
        if place[last] == value and type(place[last]) is type(value):
            raise ValueError(f"the image has {value!r} at {path} already")
        place[last] = value
    return image


def _changes(old: object, new: object, path: list[str | int]) -> Iterable[Change]:
    """Return ``(path, value)`` for every place with a new value; a place that gained or lost members counts as one place."""
    steps: Iterable[object]
    if isinstance(old, dict) and isinstance(new, dict) and old.keys() == new.keys():
        steps = old
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        steps = range(len(old))
    else:
        # In JSON true is not 1; and 1.0 is kept apart from 1.
        if old != new or type(old) is not type(new):
            yield path, new
        return
    for step in steps:
        # Most of an image is as it was: a call for each equal number would be most of what a repetition costs.
        one, other = old[step], new[step]
        if isinstance(one, dict | list) or one != other or type(one) is not type(other):
            yield from _changes(one, other, [*path, step])
