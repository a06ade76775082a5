"""The output schema that every tool declares: the envelope, strict at its top."""

from __future__ import annotations

from typing import Any

__all__ = ["output_schema"]

_ERROR = {
    "type": "object",
    "additionalProperties": False,
    "required": ["code", "class", "message", "retryable", "outcome"],
    "properties": {
        "code": {"type": "string"},
        "class": {
            "enum": ["validation", "policy", "device", "state", "transport", "protocol", "client", "internal"]
        },
        "message": {"type": "string", "minLength": 1, "maxLength": 500},
        "retryable": {"type": "boolean"},
        "outcome": {"enum": ["not_sent", "rejected", "unknown", "partial", "applied", "not_applicable"]},
        "field": {"type": "string"},
        "allowed": {"type": "object"},
        "details": {"type": "object"},
    },
}


def output_schema() -> dict[str, Any]:
    """JSON Schema 2020-12 of the envelope ``{success, data, error, meta}``."""
    return {
        "type": "object",
        "additionalProperties": False,
        "required": ["success", "data", "error", "meta"],
        "properties": {
            "success": {"type": "boolean"},
            "data": {"type": ["object", "null"]},
            "error": {"anyOf": [{"type": "null"}, _ERROR]},
            "meta": {"type": "object", "required": ["schema", "protocol", "latency_ms", "attempts", "trace"]},
        },
    }
