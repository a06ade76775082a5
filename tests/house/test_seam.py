"""The protocol seam: the kit does not name a protocol outside of that protocol's own folders and files.

A protocol's own files are those with its name in a folder's or file's name. Two further modules exist to name protocols:
``protocols/own.py``, the explicit list of the kit's own protocols, and ``devices.py``, which keeps the documented
import path of their handles.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import pytest_otmcp

KIT = Path(pytest_otmcp.__file__).parent
OTHER_ROOMS = ("conformance", "mocks", "reference_adapters")
"""Folders of their own in the checkout that lie in the kit's folder in a wheel."""

NAME = re.compile(r"modbus|mqtt|opc[ _-]?ua|opc\.tcp|sparkplug|snap7|(?-i:(?<![a-z])s7)", re.IGNORECASE)
"""``S7`` in capital letters is also the id of an item, and ``S7comm`` one of the further protocols that the paper lists."""

LISTS = {"protocols/own.py", "devices.py"}

DATA = {
    "subject/reference.toml": "describes the kit's reference adapters, as a vendor's file describes the vendor's",
    "subject/named.toml": "describes those of them that have a vocabulary of their own",
    "subject/subject.schema.json": "is built from the registered protocols, for editors",
}
"""Files that are data about certain adapters and protocols, each with what it is."""

TEXTS = {".css", ".jinja", ".json", ".toml"}


def files() -> list[str]:
    """List every file of the kit that must not name a protocol."""
    found = (path.relative_to(KIT) for path in KIT.rglob("*") if path.suffix in {".py", *TEXTS})
    return sorted(
        path.as_posix()
        for path in found
        if path.parts[0] not in OTHER_ROOMS
        and not NAME.search(path.as_posix())
        and path.as_posix() not in LISTS | {*DATA}
    )


def named_in_code(source: str) -> Iterator[str]:
    """Find the identifiers and strings of a module that contain a protocol's name, docstrings excepted."""
    tree = ast.parse(source)
    docstrings = {id(statement.value) for node in ast.walk(tree) for statement in expression_statements(node)}
    for node in ast.walk(tree):
        for text in texts_of(node):
            if id(node) not in docstrings and NAME.search(text):
                yield f"line {getattr(node, 'lineno', '?')}: {text[:100]!r}"


def expression_statements(node: ast.AST) -> Iterator[ast.Expr]:
    """Find the constants that stand alone: docstrings, also those that follow an assignment."""
    body = getattr(node, "body", None)
    for statement in body if isinstance(body, list) else ():
        if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant):
            yield statement


def texts_of(node: ast.AST) -> Iterator[str]:
    """Yield the node's own identifiers (names, attributes, arguments, keywords, imports), or its string; f-strings by parts."""
    for _, value in ast.iter_fields(node):
        for text in value if isinstance(value, list) else [value]:
            if isinstance(text, str):
                yield text
            elif isinstance(text, bytes):
                yield text.decode("latin-1")


def named_in_text(text: str) -> Iterator[str]:
    """Find the lines of a text file that contain a protocol's name."""
    return (
        f"line {number}: {line.strip()[:100]!r}"
        for number, line in enumerate(text.splitlines(), 1)
        if NAME.search(line)
    )


@pytest.mark.parametrize("file", files())
def test_a_file_that_is_no_protocols_own_names_none(file: str) -> None:
    text = (KIT / file).read_text(encoding="utf-8")
    assert list(named_in_code(text) if file.endswith(".py") else named_in_text(text)) == []


def test_what_is_excepted_is_there() -> None:
    assert all((KIT / file).is_file() for file in LISTS | {*DATA})


@pytest.mark.parametrize(
    "source",
    [
        "import pymodbus",
        "from x import y as mqtt_oracle",
        "from .mqtt import oracle",
        "run.modbus",
        "def read_opcua(): pass",
        "def f(modbus): pass",
        "f(opcua=1)",
        "class MqttHandle: pass",
        "x = 'OPC UA'",
        "x = b'sparkplug'",
        "x = f'{y} opc.tcp {z}'",
        "x = {'mqtt': 1}",
        "x['Modbus']",
        "global modbus",
        "match x:\n    case {'a': mqtt}: pass",
        "def f():\n    return 'mqtt'",
        "def f(x='mqtt'): pass",
    ],
)
def test_a_name_is_found_wherever_code_has_it(source: str) -> None:
    assert list(named_in_code(source))


@pytest.mark.parametrize(
    "source", ["'''Modbus.'''", "def f():\n    '''Read MQTT.'''", "X = 1\n'''As in OPC UA.'''", "x = 1  # Modbus"]
)
def test_docstrings_and_comments_may_explain(source: str) -> None:
    assert not list(named_in_code(source))
