"""The abstract operations on EtherNet/IP. Tags are named as Logix writes them: ``Levels[2]``, ``Recipe.Rate``, ``Program:Main.Step``."""

from __future__ import annotations

from collections.abc import Mapping

from ..protocol import Operation

__all__ = ["OPERATIONS"]

OPERATIONS: Mapping[str, Operation] = {
    "ping": Operation(meaning="is the controller reachable", outputs=("reachable",), status=True, tells="reachable"),
    "read_tag": Operation(
        meaning="read the value of a tag",
        inputs=("tag",),
        outputs=("value",),
        needed=("value",),
        voluntary_outputs=("data_type", "special"),
    ),
    "read_array": Operation(
        meaning="read elements of an array, from the one that the name has an index for",
        inputs=("tag", "count"),
        outputs=("values",),
        needed=("values",),
    ),
    "write_tag": Operation(
        meaning="write the value of a tag",
        inputs=("tag", "value", "type"),
        outputs=("value",),
        writes=True,
        optional=("type",),
    ),
    "write_array": Operation(
        meaning="write elements of an array, from the one that the name has an index for",
        inputs=("tag", "values"),
        outputs=("values",),
        writes=True,
        voluntary=True,
    ),
    "read_tags": Operation(
        meaning="read several tags, in the order asked for",
        inputs=("tags",),
        outputs=("values",),
        needed=("values",),
        voluntary=True,
    ),
    "write_tags": Operation(
        meaning="write several tags; each of items has tag_name and value",
        inputs=("items",),
        outputs=("statuses",),
        writes=True,
        voluntary=True,
    ),
    "list_tags": Operation(
        meaning="list the tags of the controller, or of a program",
        inputs=("program",),
        outputs=("tags",),
        needed=("tags",),
        optional=("program",),
        voluntary=True,
    ),
    "read_alias": Operation(
        meaning="read a tag by a name of the adapter's own",
        inputs=("name",),
        outputs=("value",),
        needed=("value",),
        voluntary=True,
    ),
    "write_alias": Operation(
        meaning="write a tag by a name of the adapter's own",
        inputs=("name", "value"),
        outputs=("value",),
        writes=True,
        voluntary=True,
    ),
    "read_clock": Operation(
        meaning="read the controller's clock, as ISO 8601 text",
        outputs=("time",),
        needed=("time",),
        voluntary=True,
    ),
    "set_clock": Operation(
        meaning="set the controller's clock to a time in ISO 8601",
        inputs=("time",),
        outputs=("time",),
        writes=True,
        controls=True,
        voluntary=True,
    ),
}
