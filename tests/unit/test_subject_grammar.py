"""The grammar of the subject file is stated once: schema and documentation say the same."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from pytest_otmcp.protocols.modbus.tags import TAGS
from pytest_otmcp.protocols.protocol import Choice, Operation, OtProtocol
from pytest_otmcp.protocols.registry import OWN, protocols
from pytest_otmcp.subject.grammar import OUTPUT_TABLE, adapter_table, binding_table, subject_file
from pytest_otmcp.subject.kinds import OneOf, Refusal
from pytest_otmcp.subject.schema import schema, schema_text
from pytest_otmcp.subject.tables import Named, Table

DOCUMENTATION = (Path(__file__).parents[2] / "docs" / "subject-file.md").read_text(encoding="utf-8")


def own() -> Mapping[str, OtProtocol]:
    return {key: protocols()[key] for key in OWN}


def test_the_schema_has_an_identity_that_is_no_address() -> None:
    assert schema(own())["$id"].startswith("urn:")
    jsonschema.Draft202012Validator.check_schema(schema(own()))


def test_a_command_prints_the_schema_for_all_protocols_that_are_installed() -> None:
    command = [sys.executable, "-m", "pytest_otmcp.subject.schema"]
    printed = subprocess.run(command, check=True, capture_output=True, text=True, encoding="utf-8").stdout
    assert printed == schema_text(protocols())


def properties(schema: Any) -> Iterator[tuple[str, dict[str, Any]]]:
    if isinstance(schema, dict):
        for key, value in schema.items():
            if key == "properties":
                yield from value.items()
            # The rules below "allOf" say which keys must be there, not what the keys mean.
            if key != "allOf":
                yield from properties(value)
    elif isinstance(schema, list):
        for value in schema:
            yield from properties(value)


def test_an_editor_can_show_the_meaning_of_every_key() -> None:
    known = dict(properties(schema(own())))
    assert {"command", "bind", "publish", "subscribe.qos", "missing_address", "expires"} <= known.keys()
    assert [name for name, key in properties(schema(own())) if not key.get("description", "").endswith(".")] == []


@pytest.mark.parametrize("key", OWN)
def test_the_schema_has_every_operation_and_facet_of_a_protocol(key: str) -> None:
    definitions = schema(own())["$defs"]
    protocol = protocols()[key]
    assert set(definitions[f"adapter.{key}.bind"]["properties"]) == set(protocol.operations)
    assert set(definitions[f"adapter.{key}.unclaimed"]["properties"]) == set(protocol.facets)
    assert {f"adapter.{key}.bind.{name}" for name in protocol.operations} <= set(definitions)


def toy() -> OtProtocol:
    """Return a protocol of a third party, made of the first protocol of the kit."""
    return replace(
        protocols()[OWN[0]],
        key="toy",
        name="Toy",
        operations={
            "echo": Operation(meaning="ask for an echo", inputs=("text",), outputs=("text",), needed=("text",))
        },
        probes={"bad_text": "\0"},
        choices=(Choice(key="voice", default="low", meaning="how it sounds", unclaims={"low": {}, "high": {}}),),
    )


TOY = {
    "command": ["adapter"],
    "voice": "high",
    "answer": "json",
    "unclaimed": {"guard": "has none"},
    "probes": {"bad_text": "x"},
    "bind": {"echo": {"tool": "echo", "arguments": {"say": "$text"}, "result": {"text": "said"}}},
}


@pytest.mark.parametrize(
    ("change", "right"),
    [
        ({}, True),
        ({"voice": "shrill"}, False),
        ({"probes": {"missing_address": 1}}, False),
        ({"unclaimed": {"ping": "is not of this protocol"}}, False),
        ({"bind": {"ping": {"tool": "ping"}}}, False),
        ({"bind": {"echo": {"tool": "echo"}}}, False),
    ],
    ids=["as it is", "choice", "probe", "facet", "operation", "output"],
)
def test_a_protocol_of_a_third_party_has_a_grammar_and_a_schema_of_its_own(change: dict[str, Any], right: bool) -> None:
    known = {**own(), "toy": toy()}
    document = {"subject": {"name": "x", "version": "1"}, "adapter": {"toy": {**TOY, **change}}}
    assert "adapter.toy.bind.echo" in schema(known)["$defs"]
    assert jsonschema.Draft202012Validator(schema(known)).is_valid(document) == right
    assert not jsonschema.Draft202012Validator(schema(own())).is_valid(document)
    if right:
        read = subject_file(known).read(document, "")["adapter"]["toy"]
        assert (read["voice"], read["deadline_s"], read["bind"]["echo"]["when"]) == ("high", 5.0, {})
    else:
        with pytest.raises(Refusal, match=r"^adapter\.toy\."):
            subject_file(known).read(document, "")


def rows(section: str, header: str) -> dict[str, str]:
    """Return a table of the documentation: the first cell of each row to the rest of the row."""
    _, _, text = DOCUMENTATION.partition(f"\n## {section}\n")
    _, _, table = text.partition(f"| {header} |\n")
    assert table, f"there is no table {header!r} in {section!r}"
    lines = table.partition("\n\n")[0].splitlines()[1:]
    return {first.strip(): rest.strip() for _, first, rest in (line.rstrip("| ").split("|", 2) for line in lines)}


def keys(table: Mapping[str, str]) -> list[str]:
    return [name for cell in table for name in re.findall(r"`(\w+)`", cell)]


def adapters() -> dict[str, Table]:
    return {key: adapter_table(protocol) for key, protocol in own().items()}


def test_the_documentation_names_every_key_of_an_adapter_and_no_other() -> None:
    known = {name for table in adapters().values() for name in table.keys}
    assert set(keys(rows("How it is started", "key | meaning"))) <= known
    missing = [name for name in known if not re.search(rf"`{name}`|^{name} = |`{name} = ", DOCUMENTATION, re.MULTILINE)]
    assert missing == []


def test_the_documentation_has_the_defaults_and_choices_of_an_adapter() -> None:
    started = rows("How it is started", "key | meaning")
    for table in adapters().values():
        for name, key in table.keys.items():
            kind = key.kind.kind if isinstance(key.kind, Named) else key.kind
            if isinstance(kind, OneOf):
                assert [value for value in kind.known if f'"{value}"' not in DOCUMENTATION] == [], name
            if isinstance(key.default, str):
                assert re.search(rf'`"{key.default}"` \(default\)|default, `"{key.default}"`', DOCUMENTATION), name
            if isinstance(key.default, float):
                assert started[f"`{name}`"].startswith(f"{key.default:g};"), name


def test_the_documentation_has_the_keys_of_a_binding() -> None:
    listed = keys(rows("Which tool does what", "key | meaning"))
    for protocol in own().values():
        for operation in protocol.operations.values():
            assert sorted(listed) == sorted(binding_table(operation).keys)


def test_the_documentation_has_the_members_of_an_output() -> None:
    assert keys(rows("How its answers are read", "member | meaning")) == list(OUTPUT_TABLE.keys)


def test_the_documentation_has_every_operation_with_its_inputs_and_outputs() -> None:
    header = "protocol | facets (operation: inputs → outputs; needed outputs in bold)"
    listed = rows("What it claims", header)
    for key, protocol in own().items():
        expected = []
        for name, operation in protocol.operations.items():
            if not operation.voluntary:
                expected.append(documented(name, operation.inputs, outputs_of(operation)))
        assert re.sub(r" \([^)]*\)", "", listed[key]) == " · ".join(expected)


def documented(name: str, inputs: Sequence[str], outputs: Sequence[str]) -> str:
    text = f"`{name}`" + (f": {', '.join(inputs)}" if inputs else "")
    return text + (f" → {', '.join(outputs)}" if outputs else "")


def outputs_of(operation: Operation) -> list[str]:
    return [f"**{output}**" if output in operation.needed else output for output in operation.outputs]


def test_the_documentation_has_what_is_claimed_by_binding_it() -> None:
    header = (
        "protocol | further operations (operation: inputs → outputs; needed outputs in bold, "
        "further inputs and outputs in brackets)"
    )
    listed = rows("What it claims", header)
    for key, protocol in own().items():
        expected = []
        for name, operation in protocol.operations.items():
            inputs = [f"[{one}]" for one in operation.voluntary_inputs]
            outputs = [f"[{one}]" for one in operation.voluntary_outputs]
            if operation.voluntary:
                inputs, outputs = [*operation.inputs, *inputs], [*outputs_of(operation), *outputs]
            if operation.voluntary or inputs or outputs:
                expected.append(documented(name, inputs, outputs))
        assert listed[key] == " · ".join(expected)


def test_the_documentation_has_the_tags_of_a_launch() -> None:
    listed = rows("What it claims", "tag | table, address | type, order | scale, offset | writable")
    for name, tag in TAGS.items():
        cells = f"{tag.table} {tag.address} | {tag.type} {tag.order} | {tag.scale}, {tag.offset} | "
        assert listed[f"`{name}`"] == cells + ("yes" if tag.writable else "no")
    assert len(listed) == len(TAGS)
