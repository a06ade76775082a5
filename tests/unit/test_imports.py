"""The libraries that an adapter's own program imports: seen in its files, never guessed."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from pytest_otmcp.subject.imports import libraries_used


def write(folder: Path, **files: str) -> None:
    for name, text in files.items():
        path = folder / name.replace("__", "/").replace("_dot_", ".")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


def test_the_file_that_the_command_names_is_read(tmp_path: Path) -> None:
    write(tmp_path, server_dot_py="import os\nfrom pymodbus.client import ModbusTcpClient\nimport mcp.server\n")
    assert libraries_used([sys.executable, str(tmp_path / "server.py")], None) == {
        "mcp": "server.py",
        "pymodbus": "server.py",
    }
    assert libraries_used([sys.executable, "server.py"], tmp_path).keys() == {"mcp", "pymodbus"}


def test_the_adapters_own_files_beside_it_are_read_too(tmp_path: Path) -> None:
    write(tmp_path, server_dot_py="import plc\n", plc_dot_py="import asyncua\n", other_dot_py="import pymodbus\n")
    assert libraries_used([sys.executable, "server.py"], tmp_path) == {"asyncua": "plc.py"}


def test_a_module_and_a_console_script_lead_to_their_package_alone(tmp_path: Path) -> None:
    site = tmp_path / "lib" / "python3.11" / "site-packages"
    write(site, acme____init___dot_py="", acme__server_dot_py="import paho.mqtt.client\nimport helper\n")
    write(site, helper_dot_py="import pymodbus\n", pymodbus_dot_py="import asyncua\n")
    write(tmp_path, bin__python="", bin__acme="#!/usr/bin/python\nfrom acme.server import main\nmain()\n")
    for program in ("python", "acme"):
        (tmp_path / "bin" / program).chmod(0o755)
    assert libraries_used([str(tmp_path / "bin" / "python"), "-P", "-m", "acme"], None) == {"paho-mqtt": "server.py"}
    assert libraries_used([str(tmp_path / "bin" / "acme")], None) == {"paho-mqtt": "server.py"}


@pytest.mark.parametrize(
    "text",
    [
        '"""Unlike others it does not\nimport pymodbus\n"""\n',
        "# import pymodbus\n",
        "print('import pymodbus')\n",
        "import pymodbus_mock\n",
        "import pymodbus (\n",
        "\0",
        "(" * 10_000,
    ],
)
def test_words_about_a_library_and_files_that_are_no_program_prove_nothing(tmp_path: Path, text: str) -> None:
    write(tmp_path, server_dot_py=text)
    assert libraries_used([sys.executable, "server.py"], tmp_path) == {}


def test_a_program_that_cannot_be_read_uses_nothing_known(tmp_path: Path) -> None:
    assert libraries_used(["no-such-program"], tmp_path) == {}
    assert libraries_used(["docker", "run", "acme/adapter"], tmp_path) == {}
