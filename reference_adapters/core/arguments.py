"""Strict arguments: nothing is coerced, nothing unknown is ignored, nothing infinite is let through.

An SDK that turns ``"70"`` into 70 or drops a misspelt ``unit`` writes a value nobody asked for to a device nobody
meant.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from .errors import AdapterError

__all__ = ["Arguments", "BoundsCode", "parse_arguments"]

_BOUNDS = {"greater_than", "greater_than_equal", "less_than", "less_than_equal"}
_TOO_MUCH = {"too_long", "string_too_long", "bytes_too_long"}


class Arguments(BaseModel):
    """Base of every tool's arguments."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


@dataclass(frozen=True, slots=True)
class BoundsCode:
    """Annotation: the error code of a value outside the field's bounds, where ``invalid_input`` is not it."""

    code: str


A = TypeVar("A", bound=Arguments)


def parse_arguments(model: type[A], arguments: dict[str, Any] | None) -> A:
    """Check a call's arguments.

    Raises:
        AdapterError: the first fault, with a JSON Pointer to it.
    """
    try:
        return model.model_validate(arguments or {})
    except ValidationError as error:
        fault = error.errors(include_url=False, include_input=False)[0]
        raise _refusal(model, fault) from None


def _refusal(model: type[Arguments], fault: Any) -> AdapterError:
    pointer = "".join(f"/{part}" for part in fault["loc"]) or "/"
    kind = fault["type"]
    allowed = {name: value for name, value in (fault.get("ctx") or {}).items() if isinstance(value, int | float | str)}
    if kind == "extra_forbidden":
        known = ", ".join(model.model_fields) or "none"
        return AdapterError("invalid_input", f"unknown argument {pointer}; known are: {known}", field=pointer)
    if kind == "missing":
        return AdapterError("invalid_input", f"the argument {pointer} is missing", field=pointer)
    code = "invalid_input"
    if kind in _BOUNDS:
        field = model.model_fields.get(str(fault["loc"][0]))
        codes = [mark.code for mark in (field.metadata if field else []) if isinstance(mark, BoundsCode)]
        code = codes[0] if codes else code
    elif kind in _TOO_MUCH:
        code = "limit_exceeded"
    return AdapterError(code, f"{pointer}: {fault['msg']}", field=pointer, allowed=allowed or None)
