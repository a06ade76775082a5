"""Strict arguments: nothing is coerced, nothing unknown is ignored, nothing infinite is accepted.

An SDK that turns ``"70"`` into 70 writes a value that the caller did not ask for; an SDK that drops a misspelt ``unit``
writes it to a device that the caller did not mean.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from .errors import AdapterError

__all__ = ["LEFT_OUT", "Arguments", "BoundsCode", "Nothing", "parse_arguments"]

_BOUNDS = {"greater_than", "greater_than_equal", "less_than", "less_than_equal"}
_TOO_MUCH = {"too_long", "string_too_long", "bytes_too_long"}
_MAX_NAME = 100

LEFT_OUT: Any = None
"""Default of an argument that was not given. An argument cannot be left out by null; null is refused."""
_MAX_DEPTH = 20
_MAX_ELEMENTS = 100_000


class Arguments(BaseModel):
    """Base of every tool's arguments, and of every object inside them.

    A rule that involves several arguments is a ``model_validator(mode="after")`` that raises :class:`AdapterError`. An
    optional argument that may be left out but not be null is ``name: int = Field(default=LEFT_OUT, …)``.
    """

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


class Nothing(Arguments):
    """No arguments."""


@dataclass(frozen=True, slots=True)
class BoundsCode:
    """Annotation: the error code for a value outside the field's bounds, instead of ``invalid_input``."""

    code: str


A = TypeVar("A", bound=Arguments)


def parse_arguments(model: type[A], arguments: Any) -> A:
    """Check a call's arguments, which may be any JSON value, and return them as a model.

    Raises:
        AdapterError: the first fault, with a JSON Pointer to it.
    """
    if arguments is None:
        arguments = {}
    if not isinstance(arguments, dict):
        raise AdapterError("invalid_input", "the arguments must be an object of names and values", field="")
    _refuse_what_json_lacks(arguments)
    try:
        return model.model_validate(arguments)
    except ValidationError as error:
        fault = error.errors(include_url=False, include_input=False)[0]
        raise _refusal(model, arguments, fault) from None


def _refuse_what_json_lacks(value: Any, pointer: str = "", depth: int = 0) -> None:
    # A JSON parser reads 1e999 as infinity and "\\ud800" as half a character. A model's "any value" or "any text" accepts
    # both.
    if isinstance(value, float) and not math.isfinite(value):
        raise AdapterError("invalid_input", f"{pointer}: numbers must be finite", field=pointer)
    if isinstance(value, str) and not value.isascii() and _is_half_text(value):
        raise AdapterError("invalid_input", f"{pointer}: the text holds a lone surrogate", field=pointer)
    if not isinstance(value, dict | list):
        return
    if depth == _MAX_DEPTH:
        raise AdapterError("limit_exceeded", f"arguments may be nested {_MAX_DEPTH} deep", field=pointer[:_MAX_NAME])
    if len(value) > _MAX_ELEMENTS:
        raise AdapterError("limit_exceeded", f"{pointer}: at most {_MAX_ELEMENTS} elements", field=pointer)
    for name, member in value.items() if isinstance(value, dict) else enumerate(value):
        if isinstance(member, float | str | dict | list):
            _refuse_what_json_lacks(member, f"{pointer}/{_escaped(name)}", depth + 1)


def _is_half_text(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return True
    return False


def _escaped(name: object) -> str:
    text = str(name)[:_MAX_NAME].encode("utf-8", "replace").decode()
    return text.replace("~", "~0").replace("/", "~1")


def _pointer(arguments: Any, location: tuple[int | str, ...]) -> str:
    """Return the JSON Pointer (RFC 6901) to a fault, without the branches of unions that pydantic's location names."""
    pointer = ""
    for index, part in enumerate(location):
        inside = (isinstance(arguments, dict) and part in arguments) or (
            isinstance(arguments, list) and isinstance(part, int) and part < len(arguments)
        )
        if inside or (isinstance(arguments, dict) and index == len(location) - 1):
            pointer += f"/{_escaped(part)}"
        arguments = arguments[part] if inside else None
    return pointer


def _refusal(model: type[Arguments], arguments: dict[str, Any], fault: Any) -> AdapterError:
    kind, location = fault["type"], fault["loc"]
    pointer = _pointer(arguments, location)
    allowed = {name: value for name, value in (fault.get("ctx") or {}).items() if isinstance(value, int | float | str)}
    code = "invalid_input"
    if kind == "extra_forbidden":
        known = ", ".join(model.model_fields) or "none"
        message = f"unknown argument {pointer}" + (f"; known are: {known}" if len(location) == 1 else "")
    elif kind == "missing":
        message = f"the argument {pointer} is missing"
    else:
        message = f"{pointer}: {fault['msg']}"
        code = _code(model, kind, location)
    return AdapterError(code, message, field=pointer, allowed=allowed or None)


def _code(model: type[Arguments], kind: str, location: tuple[int | str, ...]) -> str:
    if kind in _TOO_MUCH:
        return "limit_exceeded"
    field = model.model_fields.get(str(location[0])) if location else None
    if kind not in _BOUNDS or field is None:
        return "invalid_input"
    code = next((mark.code for mark in field.metadata if isinstance(mark, BoundsCode)), "invalid_input")
    # A limit is an upper bound: a count of -1 exceeds no limit, it is invalid.
    return "invalid_input" if code == "limit_exceeded" and kind.startswith("greater") else code
