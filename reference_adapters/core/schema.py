"""The schemas that a tool declares: of its arguments, and of its result, the envelope (``otmcp/1.0``) with the tool's
data."""

from __future__ import annotations

from typing import Any

from pydantic import TypeAdapter

from .arguments import Arguments

__all__ = ["input_schema", "output_schema"]

_ERROR = {
    "type": "object",
    "additionalProperties": False,
    "required": ["code", "class", "message", "retryable", "outcome"],
    "properties": {
        "code": {"type": "string"},
        "class": {"enum": ["validation", "policy", "device", "state", "transport", "protocol", "client", "internal"]},
        "message": {"type": "string", "minLength": 1, "maxLength": 500},
        "retryable": {"type": "boolean"},
        "outcome": {"enum": ["not_sent", "rejected", "unknown", "partial", "applied", "not_applicable"]},
        "field": {"type": "string"},
        "allowed": {"type": "object"},
        "details": {"type": "object"},
        "retry_after_ms": {"type": "integer", "minimum": 0},
    },
}

_META = {
    "type": "object",
    "required": [
        "schema",
        "protocol",
        "operation",
        "endpoint",
        "started_at",
        "latency_ms",
        "attempts",
        "request_id",
        "source",
        "connection",
        "trace",
    ],
    "properties": {
        "schema": {"const": "otmcp/1.0"},
        "protocol": {"type": "string"},
        "operation": {"type": "string"},
        "endpoint": {"type": "string"},
        "started_at": {"type": "string"},
        "latency_ms": {"type": "number", "minimum": 0},
        "attempts": {"type": "integer", "minimum": 0},
        "request_id": {"type": "string"},
        "source": {"enum": ["device", "cache", "none"]},
        "connection": {
            "type": "object",
            "required": ["state", "generation"],
            "properties": {
                "state": {"enum": ["connected", "disconnected", "reconnected"]},
                "generation": {"type": "integer", "minimum": 0},
            },
        },
        "trace": {"type": "object"},
    },
}

_PARTIAL = {"type": "object", "additionalProperties": False, "required": ["partial"], "properties": {"partial": {}}}


def input_schema(model: type[Arguments]) -> dict[str, Any]:
    """Return the JSON Schema 2020-12 of a tool's arguments."""
    schema = model.model_json_schema()
    _tidy(schema)
    schema.pop("description", None)
    return schema


def output_schema(data: Any) -> dict[str, Any]:
    """Return the JSON Schema 2020-12 of the envelope ``{success, data, error, meta}``.

    Args:
        data: type of ``data`` in a success: a ``TypedDict`` (of ``typing_extensions``: pydantic cannot read the standard
            one before Python 3.12), or ``dict[str, Any]`` for any object.
    """
    shape = TypeAdapter(data).json_schema()
    _tidy(shape)
    definitions = shape.pop("$defs", None)
    return {
        "type": "object",
        "additionalProperties": False,
        "required": ["success", "data", "error", "meta"],
        "properties": {
            "success": {"type": "boolean"},
            "data": {"anyOf": [{"type": "null"}, shape, _PARTIAL]},
            "error": {"anyOf": [{"type": "null"}, _ERROR]},
            "meta": _META,
        },
        **({"$defs": definitions} if definitions else {}),
    }


def _tidy(schema: Any) -> None:
    # Titles repeat the names. A default of null stands for "may be left out"; null itself is refused.
    if isinstance(schema, list):
        for member in schema:
            _tidy(member)
    elif isinstance(schema, dict):
        if isinstance(schema.get("title"), str):
            del schema["title"]
        if "default" in schema and schema["default"] is None and "type" in schema:
            del schema["default"]
        for member in schema.values():
            _tidy(member)
