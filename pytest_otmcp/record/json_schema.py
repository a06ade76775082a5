"""The JSON Schema of a run record: ``otmcp docs run.schema.json`` prints it, and the build stores it beside this module."""

from __future__ import annotations

import inspect
import json
from typing import Any, cast

import msgspec

from .layout import COUNTED_BY_READERS, DERIVED_OF_CALL, USUAL_OF_CALL
from .schema import (
    SCHEMA,
    CallJudgement,
    DeviceEvidence,
    EntryEvidence,
    ItemJudgement,
    Run,
    SampleJudgement,
)

__all__ = ["json_schema"]

_JUDGEMENTS = {"Call": CallJudgement, "Sample": SampleJudgement, "Item": ItemJudgement}
_EVIDENCE = {"JournalEntry": EntryEvidence, "DeviceEntry": DeviceEvidence}


def json_schema() -> str:
    """Return the JSON Schema of :data:`~pytest_otmcp.record.schema.SCHEMA` as text: of the file, not of a record in memory."""
    shapes = (Run, *_JUDGEMENTS.values(), *_EVIDENCE.values())
    (schema, *_), found = msgspec.json.schema_components(shapes, ref_template="#/$defs/{name}")
    definitions = cast("dict[str, dict[str, Any]]", found)
    for name, kept in _EVIDENCE.items():
        definitions[name] = _reference(kept)
    for name, judgement in _JUDGEMENTS.items():
        _without(definitions[name], judgement.__annotations__)
        definitions[name]["properties"]["judgement"] = _reference(judgement)
        definitions[name]["required"].append("judgement")
    _without(definitions["Call"], DERIVED_OF_CALL)
    definitions["CallJudgement"]["properties"]["envelope"] = definitions["Call"]["properties"]["envelope"]
    _optional(definitions["Call"], {*USUAL_OF_CALL, "envelope"})
    _without(definitions["Footer"], COUNTED_BY_READERS)
    for definition in definitions.values():
        if "description" in definition:
            definition["description"] = inspect.cleandoc(definition["description"])
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": SCHEMA}
    return json.dumps({**head, **schema, "$defs": definitions}, indent=1, ensure_ascii=False) + "\n"


def _reference(shape: type) -> dict[str, Any]:
    return {"$ref": f"#/$defs/{shape.__name__}"}


def _without(definition: dict[str, Any], names: Any) -> None:
    _optional(definition, names)
    definition["properties"] = {name: one for name, one in definition["properties"].items() if name not in names}


def _optional(definition: dict[str, Any], names: Any) -> None:
    definition["required"] = [name for name in definition["required"] if name not in names]


if __name__ == "__main__":
    print(json_schema(), end="")
