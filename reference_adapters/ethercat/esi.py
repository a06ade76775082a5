"""What an ESI file (EtherCAT Slave Information, ETG.2000) says of its devices."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from typing import Any

__all__ = ["BadEsi", "parse"]


class BadEsi(Exception):
    """This is no ESI file."""


def parse(content: bytes) -> dict[str, Any]:
    """Return ``vendor``, ``vendor_id`` and ``devices`` of an ESI file.

    Raises:
        BadEsi: it is none.
    """
    if b"<!DOCTYPE" in content or b"<!ENTITY" in content:
        raise BadEsi("it declares entities, which no ESI file needs")
    try:
        root = ElementTree.fromstring(content)  # noqa: S314  (without entities there is nothing to expand)
    except ElementTree.ParseError:
        raise BadEsi("it is no XML") from None
    if root.tag != "EtherCATInfo":
        raise BadEsi("its root is not EtherCATInfo")
    return {
        "vendor": _text(root.find("Vendor/Name")),
        "vendor_id": _number(_text(root.find("Vendor/Id"))),
        "devices": [
            {
                "type": _text(device.find("Type")),
                "product_code": _number(_attribute(device, "ProductCode")),
                "revision": _number(_attribute(device, "RevisionNo")),
            }
            for device in root.findall("Descriptions/Devices/Device")
        ],
    }


def _attribute(device: ElementTree.Element, name: str) -> str | None:
    found = device.find("Type")
    return None if found is None else found.get(name)


def _text(element: ElementTree.Element | None) -> str | None:
    return None if element is None or element.text is None else element.text.strip()


def _number(text: str | None) -> int | None:
    """Return a number, whose hexadecimal form begins with ``#x``."""
    try:
        return None if text is None else int(text[2:], 16) if text.startswith("#x") else int(text)
    except ValueError:
        return None
