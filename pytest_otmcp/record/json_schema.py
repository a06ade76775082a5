"""The JSON Schema of a run record: ``otmcp docs run.schema.json`` prints it, and the build stores it beside this module."""

from __future__ import annotations

import inspect
import json

import msgspec

from .schema import SCHEMA, Run

__all__ = ["json_schema"]


def json_schema() -> str:
    """Return the JSON Schema of :data:`~pytest_otmcp.record.schema.SCHEMA` as text."""
    schema = msgspec.json.schema(Run)
    for definition in schema["$defs"].values():
        if "description" in definition:
            definition["description"] = inspect.cleandoc(definition["description"])
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": SCHEMA}
    return json.dumps({**head, **schema}, indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    print(json_schema(), end="")
