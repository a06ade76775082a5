"""An adapter whose command starts it in a namespace of processes of its own, as a container does, is judged like any other."""

from __future__ import annotations

import shutil
import subprocess
import sys

import pytest

from .conftest import Judge, passing, words

NESTED = ("unshare", "--user", "--map-root-user", "--pid", "--fork", "--kill-child")


@pytest.fixture(scope="module")
def nested() -> tuple[str, ...]:
    """The words before a command that start it in a namespace of its own."""
    if shutil.which("unshare") is None:
        pytest.skip("there is no unshare(1)")
    tried = subprocess.run([*NESTED, "true"], capture_output=True, text=True, check=False)
    if tried.returncode:
        pytest.skip(tried.stderr.strip())
    return NESTED


@pytest.mark.long
@pytest.mark.parametrize("items", ["M1 M3 S10 MCP-002.modbus MCP-009.modbus"])
def test_a_namespace_of_its_own_accuses_nobody(judge: Judge, nested: tuple[str, ...], items: str) -> None:
    adapter = (sys.executable, "-P", "-m", "pytest_otmcp.reference_adapters", "modbus")
    results = judge("modbus", command=(*nested, *adapter), tasks=items)
    assert passing(results) == set(items.split()), words(results)
    assert not any(result.get("strangers") for result in results.values())
