"""Every protocol of the kit is complete: description, codes, mock, reference adapter, tasks, a lie about writing."""

from __future__ import annotations

import re
import tomllib
from importlib import import_module, resources
from pathlib import Path
from types import ModuleType

import pytest
from pytest_otmcp.reference_adapters.defects.table import DEFECTS

from pytest_otmcp.core.error_registry import registry, wire_codes
from pytest_otmcp.core.matrix import SUITES
from pytest_otmcp.protocols.own import OWN
from pytest_otmcp.protocols.protocol import COMMANDS, READINGS, OtProtocol
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.subject import reference_subject
from pytest_otmcp.suite.catalogue import all_tasks

CHECKOUT = Path(__file__).parents[2]


@pytest.fixture(params=OWN)
def protocol(request: pytest.FixtureRequest) -> OtProtocol:
    return protocols()[request.param]


def test_every_protocol_is_complete(protocol: OtProtocol) -> None:
    assert protocol.key.isidentifier()
    assert protocol.package == f"pytest_otmcp.protocols.{protocol.key}"
    assert protocol.origin is None
    assert protocol.framing is not None, "the tap cannot be the witness"
    assert protocol.recognise.search(protocol.key)
    for name, operation in protocol.operations.items():
        assert operation.meaning, name
        assert set(operation.needed) <= set(operation.outputs), name
        assert set(operation.optional) <= set(operation.inputs), name
        voluntary = (*operation.voluntary_inputs, *operation.voluntary_outputs)
        assert len({*operation.inputs, *voluntary}) == len(operation.inputs) + len(voluntary), name
        assert not set(operation.outputs) & set(voluntary), name
        assert operation.waits is None or operation.waits in operation.inputs, name
    assert any(operation.writes for operation in protocol.operations.values())


def test_every_code_of_a_protocol_becomes_a_code_of_the_registry(protocol: OtProtocol) -> None:
    assert wire_codes(protocol.package)
    for code in wire_codes(protocol.package).values():
        assert set(code.codes) <= registry().keys(), code


def test_every_operation_is_bound_by_the_reference_subject_and_asked_for_by_a_task(protocol: OtProtocol) -> None:
    adapter = reference_subject().adapters[protocol.key]
    assert set(adapter.operations) == set(protocol.operations)
    # Named commands and readings are those of a subject file of its own.
    named = {COMMANDS} | ({READINGS} if protocol.places else set())
    assert {*adapter.offered, *named} == {facet for facet in protocol.facets if protocol.is_voluntary(facet)}
    needed = {
        real
        for task in all_tasks().values()
        for need in task.needs
        if need.partition(".")[0] == protocol.key
        for real in protocol.required_facets(need.partition(".")[2], ())
    }
    assert {name for name, operation in protocol.operations.items() if not operation.voluntary} <= needed


def test_every_protocol_has_a_mock_and_a_reference_adapter(protocol: OtProtocol) -> None:
    mock: ModuleType = import_module(f"pytest_otmcp.mocks.{protocol.mock}")
    assert mock.ENDPOINTS
    mock.warm()
    device = mock.create()
    assert device.image()["points"]
    assert import_module(f"pytest_otmcp.reference_adapters.{protocol.key}").build


def test_every_protocol_has_an_item_in_every_suite(protocol: OtProtocol) -> None:
    suites = {task.suite for task in all_tasks().values() if task.protocols == (protocol.key,)}
    assert suites == {*SUITES}


def test_every_protocol_has_a_lie_about_writing_that_the_suite_must_notice(protocol: OtProtocol) -> None:
    assert any(defect.protocol == protocol.key and defect.catalogue_id == "MU-20" for defect in DEFECTS.values())


def test_every_extra_and_colour_is_told_apart() -> None:
    known = [protocols()[key] for key in OWN]
    for attribute in ("name", "scheme", "colour"):
        assert len({getattr(protocol, attribute) for protocol in known}) == len(known), attribute


def test_the_packages_that_a_record_states_are_what_the_project_depends_on() -> None:
    """A protocol that is part of every run is a dependency; a further one is an extra of its name, and of development."""
    project = tomllib.loads((CHECKOUT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    for key in OWN:
        packages = set(protocols()[key].packages)
        if protocols()[key].always:
            assert packages <= _names(project["dependencies"])
        else:
            assert packages == _names(extras.get(key, []))
            assert packages <= _names(extras["dev"])


def _names(requirements: list[str]) -> set[str]:
    return {re.split("[<>=]", text)[0] for text in requirements}


def test_every_protocol_s_data_is_shipped(protocol: OtProtocol) -> None:
    assert (resources.files(protocol.package) / "codes.toml").is_file()
