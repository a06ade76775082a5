"""Sets of nodes that a poke adds below the Plant folder, each in a folder of its own: ``{"nodes": "types"}`` or a list of names.

==============  =========================================================================================================
``types``       folder Types: a writable variable of every built-in type, named as the type
``special``     folder Special: values that are hard to pass on: ``Double.NaN``, ``Float.Subnormal``, ``UInt64.Above2To53``,
                ``DateTime.Min``, ``String.Bidi``, ``Null``, and so on
``arrays``      folder Arrays: ``Int32.Vector``, ``Double.Matrix`` (2 by 3), ``String.Vector``, ``Int32.Empty``, ``ByteString.Vector``
``structures``  folder Structures: ``Range``, ``EUInformation`` and ``Argument`` as ExtensionObjects, and ``Range.Vector``
``access``      folder Access: ``ReadOnly``, ``Denied`` (others may write it, this user may not), ``Hidden``, ``Writable``
``analog``      folder Analog: ``Level``, an AnalogItemType with EURange 0 to 100 and EngineeringUnits; a write beyond the range is
                refused with BadOutOfRange
``cycle``       folders CycleA, CycleB and CycleC, each of which organizes the next, and the last the first
``methods``     ``Mix`` (Int32, String), ``Flags`` (Boolean, Byte, Double) and ``Nothing``; they return their arguments
``wide``        folder Wide.Folder with 2 500 variables, ``Wide`` and ``Wide1`` to ``Wide2499``
``many``        folder Many.Folder with 10 000 variables, ``Many`` and ``Many1`` to ``Many9999``
==============  =========================================================================================================
"""

from __future__ import annotations

import base64
from typing import Any

__all__ = ["SETS", "sample"]

_Node = dict[str, Any]

_TYPES: dict[str, Any] = {
    "Boolean": True,
    "SByte": -128,
    "Byte": 255,
    "Int16": -32768,
    "UInt16": 65535,
    "Int32": -(2**31),
    "UInt32": 2**32 - 1,
    "Int64": -(2**63),
    "UInt64": 2**64 - 1,
    "Float": 0.5,
    "Double": 0.1,
    "String": "text",
    "DateTime": "2026-11-22T12:00:00.123456+00:00",
    "Guid": "72962b91-fa75-4ae6-8d28-b404dc7daf63",
    "ByteString": base64.b64encode(b"\x00\xff").decode(),
    "XmlElement": "<a>1</a>",
    "NodeId": "ns=2;s=Temperature",
    "ExpandedNodeId": "ns=2;s=Temperature",
    "StatusCode": "BadSensorFailure",
    "QualifiedName": "2:Temperature",
    "LocalizedText": "text",
    "ExtensionObject": {"Range": {"Low": 0.0, "High": 100.0}},
}
_SPECIAL: list[tuple[str, str, Any]] = [
    *(
        (f"{kind}.{name}", kind, value)
        for kind in ("Float", "Double")
        for name, value in (
            ("NaN", "NaN"),
            ("Infinity", "Infinity"),
            ("MinusInfinity", "-Infinity"),
            ("MinusZero", "-0.0"),
        )
    ),
    ("Float.Subnormal", "Float", 2.0**-149),
    ("Double.Subnormal", "Double", 5e-324),
    ("Double.Highest", "Double", 1.7976931348623157e308),
    ("Int64.Above2To53", "Int64", 2**53 + 1),
    ("UInt64.Above2To53", "UInt64", 2**53 + 1),
    ("Int64.BelowMinus2To53", "Int64", -(2**53) - 1),
    ("DateTime.Min", "DateTime", "1601-01-01T00:00:00+00:00"),
    ("DateTime.Max", "DateTime", "9999-12-31T23:59:59+00:00"),
    ("DateTime.Null", "DateTime", None),
    ("String.Empty", "String", ""),
    ("String.Nul", "String", "a\0b"),
    ("String.Bidi", "String", "a\u202eb\u202c"),
    ("String.Escape", "String", "\x1b[31mred\x1b[0m"),
    ("String.Emoji", "String", "\U0001f600"),
    ("String.Null", "String", None),
    ("ByteString.Empty", "ByteString", ""),
    ("Null", "Double", None),
]
_WIDE = 2_500
_MANY = 10_000


def sample(names: Any) -> list[_Node]:
    """Return the descriptions of the nodes of these sets, for :class:`~.extra_nodes.ExtraNodes`.

    Raises:
        ValueError: there is no such set.
    """
    wanted = [names] if isinstance(names, str) else names
    if not isinstance(wanted, list) or not wanted or any(name not in SETS for name in wanted):
        raise ValueError(f"nodes: expected one of {', '.join(SETS)}, or a list of them, found {names!r}")
    return [node for name in wanted for node in SETS[name]]


def _in(folder: str, name: str, kind: str, value: Any, **members: Any) -> _Node:
    return {"variable": name, "in": folder, "type": kind, "value": value, **members}


SETS: dict[str, list[_Node]] = {
    "types": [{"folder": "Types"}, *(_in("Types", kind, kind, value) for kind, value in _TYPES.items())],
    "special": [{"folder": "Special"}, *(_in("Special", name, kind, value) for name, kind, value in _SPECIAL)],
    "arrays": [
        {"folder": "Arrays"},
        _in("Arrays", "Int32.Vector", "Int32", [1, -2, 3]),
        _in("Arrays", "Double.Matrix", "Double", [[1.0, 2.0, 3.0], [4.0, 5.0, "NaN"]], dimensions=[2, 3]),
        _in("Arrays", "String.Vector", "String", ["a", "", "\U0001f600"]),
        _in("Arrays", "ByteString.Vector", "ByteString", [base64.b64encode(b"\x00").decode(), ""]),
        _in("Arrays", "Int32.Empty", "Int32", []),
    ],
    "structures": [
        {"folder": "Structures"},
        _in("Structures", "Range", "ExtensionObject", {"Range": {"Low": -1.0, "High": 1.0}}, data_type="i=884"),
        _in(
            "Structures",
            "EUInformation",
            "ExtensionObject",
            {"EUInformation": {"NamespaceUri": "urn:unit", "UnitId": 4408652}},
            data_type="i=887",
        ),
        _in("Structures", "Argument", "ExtensionObject", {"Argument": {"Name": "a"}}, data_type="i=296"),
        _in(
            "Structures",
            "Range.Vector",
            "ExtensionObject",
            [{"Range": {"Low": 0.0, "High": 1.0}}, {"Range": {"Low": 1.0, "High": 2.0}}],
            data_type="i=884",
        ),
    ],
    "access": [
        {"folder": "Access"},
        _in("Access", "ReadOnly", "Double", 1.0, access="read"),
        _in("Access", "Denied", "Double", 2.0, access="denied_writing"),
        _in("Access", "Hidden", "Double", 3.0, access="hidden"),
        _in("Access", "Writable", "Double", 4.0),
    ],
    "analog": [
        {"folder": "Analog"},
        _in("Analog", "Level", "Double", 50.0, range=[0, 100], type_definition="i=2368"),
        _in(
            "Level",
            "Level.EURange",
            "ExtensionObject",
            {"Range": {"Low": 0.0, "High": 100.0}},
            data_type="i=884",
            property=True,
            browse_name="0:EURange",
            access="read",
        ),
        _in(
            "Level",
            "Level.EngineeringUnits",
            "ExtensionObject",
            {"EUInformation": {"NamespaceUri": "http://www.opcfoundation.org/UA/units/un/cefact", "UnitId": 20529}},
            data_type="i=887",
            property=True,
            browse_name="0:EngineeringUnits",
            access="read",
        ),
    ],
    "cycle": [
        {"folder": "CycleA"},
        {"folder": "CycleB", "in": "CycleA"},
        {"folder": "CycleC", "in": "CycleB"},
        {"reference": "CycleC", "to": "CycleA"},
    ],
    "methods": [
        {"method": "Mix", "inputs": ["Int32", "String"]},
        {"method": "Flags", "inputs": ["Boolean", "Byte", "Double"]},
        {"method": "Nothing", "inputs": []},
    ],
    "wide": [{"folder": "Wide.Folder"}, _in("Wide.Folder", "Wide", "Int32", 0, copies=_WIDE - 1)],
    "many": [{"folder": "Many.Folder"}, _in("Many.Folder", "Many", "Int32", 0, copies=_MANY - 1)],
}
