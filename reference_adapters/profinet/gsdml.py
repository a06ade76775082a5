"""The parser of GSDML files, the descriptions of PROFINET devices (GSDML specification of PROFIBUS & PROFINET International): XML."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from xml.etree import ElementTree

__all__ = ["BadGsdml", "DeviceFile", "Module", "parse"]

_FORBIDDEN = re.compile(rb"<!(DOCTYPE|ENTITY)", re.IGNORECASE)
_MOST_MODULES = 500
_SIZES = {"8": 1, "16": 2, "32": 4, "64": 8}
_TYPE = re.compile(r"(?:Unsigned|Integer|Float)(8|16|32|64)")


class BadGsdml(Exception):
    """A text that is no GSDML file; the message says why."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Module:
    """One module: its name and identifiers, and the bytes of its inputs and outputs."""

    name: str
    module: int
    submodule: int | None
    inputs: int
    outputs: int


@dataclass(slots=True, kw_only=True)
class DeviceFile:
    """What a GSDML file says of a device."""

    vendor: str
    vendor_id: int
    device_id: int
    modules: list[Module] = field(default_factory=list)


def parse(content: bytes) -> DeviceFile:
    """Return what a GSDML file says.

    Raises:
        BadGsdml: it is no XML, defines entities, or does not identify a device.
    """
    if _FORBIDDEN.search(content):
        raise BadGsdml("it declares a document type or entities")
    try:
        root = ElementTree.fromstring(content)  # noqa: S314  (entities are refused above)
    except ElementTree.ParseError as error:
        raise BadGsdml(f"no XML: {error}") from None
    identity = next(_all(root, "DeviceIdentity"), None)
    if identity is None:
        raise BadGsdml("it identifies no device (DeviceIdentity)")
    texts = {one.get("TextId"): one.get("Value", "") for one in _all(root, "Text")}
    maker = next(_all(identity, "VendorName"), None)
    file = DeviceFile(
        vendor="" if maker is None else maker.get("Value", ""),
        vendor_id=_number(identity.get("VendorID")),
        device_id=_number(identity.get("DeviceID")),
    )
    for one in (*_all(root, "DeviceAccessPointItem"), *_all(root, "ModuleItem")):
        if len(file.modules) >= _MOST_MODULES:
            raise BadGsdml(f"more than {_MOST_MODULES} modules")
        sub = next(_all(one, "VirtualSubmoduleItem"), None)
        name = next(_all(one, "Name"), None)
        file.modules.append(
            Module(
                name=texts.get(None if name is None else name.get("TextId"), one.get("ID", "")),
                module=_number(one.get("ModuleIdentNumber")),
                submodule=None if sub is None else _number(sub.get("SubmoduleIdentNumber")),
                inputs=_length(one, "Input"),
                outputs=_length(one, "Output"),
            )
        )
    return file


def _all(element: ElementTree.Element, name: str) -> Iterator[ElementTree.Element]:
    return (one for one in element.iter() if one.tag.rpartition("}")[2] == name)


def _number(text: str | None) -> int:
    try:
        return int(text or "", 16 if (text or "").lower().startswith("0x") else 10)
    except ValueError:
        raise BadGsdml(f"no number: {text!r}") from None


def _length(module: ElementTree.Element, direction: str) -> int:
    found = 0
    for area in _all(module, direction):
        for item in _all(area, "DataItem"):
            kind = _TYPE.fullmatch(item.get("DataType", ""))
            found += _SIZES[kind[1]] if kind else _number(item.get("Length", "0"))
    return found
