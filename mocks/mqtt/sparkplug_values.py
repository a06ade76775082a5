"""Metrics of Sparkplug messages as JSON, for pokes: ``{"name", "datatype", "value", "alias"}``.

``datatype`` is a name of :data:`~.sparkplug.DATATYPES`, ``alias`` and ``name`` may be left out, but not both. A value is a number, a
string (String, Text, UUID), a boolean, base64 (Bytes, File), milliseconds since the epoch (DateTime), or null. ``"NaN"``,
``"Infinity"``, ``"-Infinity"`` and ``"-0.0"`` are numbers of Float and Double that JSON does not have. A DataSet is
``{"columns": [name], "types": [name of a datatype], "rows": [[value]]}``.
"""

from __future__ import annotations

import base64
import binascii
import math
from collections.abc import Mapping
from typing import Any

from .sparkplug import DATATYPES, DataSet

__all__ = ["json_safe", "metric", "value_of"]

_RANGES = {
    **{f"Int{bits}": (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) for bits in (8, 16, 32, 64)},
    **{f"UInt{bits}": (0, 2**bits - 1) for bits in (8, 16, 32, 64)},
    "DateTime": (0, 2**64 - 1),
}
_MEMBERS = frozenset({"name", "alias", "datatype", "value"})


def metric(source: Any) -> dict[str, Any]:
    """Return a metric as :func:`~.sparkplug.encode_payload` takes it.

    Raises:
        ValueError: it is not understood.
    """
    if not isinstance(source, Mapping) or source.keys() - _MEMBERS or not {"datatype", "value"} <= source.keys():
        raise ValueError(f"a metric is {{'name', 'alias', 'datatype', 'value'}}, found {source!r}")
    name, alias = source.get("name"), source.get("alias")
    if not isinstance(name, str | None) or not (alias is None or (type(alias) is int and 0 <= alias < 2**64)):
        raise ValueError(f"a metric has a text as name and an integer as alias, found {name!r} and {alias!r}")
    if name is None and alias is None:
        raise ValueError("a metric has a name or an alias")
    return {"name": name, "alias": alias, "datatype": source["datatype"], "value": value_of(source)}


def value_of(source: Mapping[str, Any]) -> Any:
    """Return the value of a metric.

    Raises:
        ValueError: there is no such datatype, or the value does not fit it.
    """
    kind, value = source["datatype"], source["value"]
    if kind not in DATATYPES:
        raise ValueError(f"unknown datatype {kind!r}; known are {', '.join(DATATYPES)}")
    if value is None:
        return None
    if kind in ("Float", "Double") and (
        type(value) in (int, float) or value in ("NaN", "Infinity", "-Infinity", "-0.0")
    ):
        return float(value)
    if kind == "Boolean" and isinstance(value, bool):
        return value
    if kind in ("String", "Text", "UUID") and isinstance(value, str):
        return value
    if kind in ("Bytes", "File") and isinstance(value, str):
        try:
            return base64.b64decode(value, validate=True)
        except binascii.Error:
            raise ValueError(f"{value!r} is no base64") from None
    if kind == "DataSet" and isinstance(value, Mapping):
        return DataSet.of(value, lambda kind, cell: value_of({"datatype": kind, "value": cell}))
    low, high = _RANGES.get(kind, (1, 0))
    if type(value) is int and low <= value <= high:
        return value
    raise ValueError(f"{value!r} is no value of {kind}")


def json_safe(value: Any) -> Any:
    """Return a value for the image, which is JSON."""
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    if isinstance(value, bytes):
        return base64.b64encode(value).decode()
    if isinstance(value, DataSet):
        return value.as_json(json_safe)
    return value
