"""The JSON Schema of a subject file, for editors: ``otmcp docs subject.schema.json`` prints it.

The build (``setup.py``) stores the schema for the kit's own protocols beside this module. Where a package registers a further
protocol, the command prints a schema that has that protocol as well.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..protocols.own import OWN
from ..protocols.protocol import OtProtocol
from ..protocols.registry import protocols
from .grammar import subject_file
from .kinds import Definitions

__all__ = ["SHIPPED", "schema", "schema_text", "shipped_text"]

SHIPPED = Path(__file__).with_name("subject.schema.json")
"""The schema for the kit's own protocols, as editors read it; the build makes it."""


def schema(known: Mapping[str, OtProtocol]) -> dict[str, Any]:
    """Return the schema of a subject file whose adapters speak these protocols, by key."""
    definitions: Definitions = {}
    root = subject_file(known).schema(definitions)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": "urn:otmcp:subject-file",
        "title": "pytest-otmcp subject file",
        **root,
        "$defs": definitions,
    }


def schema_text(known: Mapping[str, OtProtocol]) -> str:
    """Return the schema as the text of a file."""
    return json.dumps(schema(known), indent=1, ensure_ascii=False) + "\n"


def shipped_text() -> str:
    """Return the text of :data:`SHIPPED`."""
    return schema_text({key: protocols()[key] for key in OWN})


if __name__ == "__main__":
    print(schema_text(protocols()), end="")
